// One file, two kinds of view: the batch, and #scan=ID.
function show() {
  const alone = JOBS.length === 1 ? JOBS[0] : null;
  const job = byId.get(decodeURIComponent(location.hash.replace(/^#scan=/, ""))) || alone;
  const main = document.getElementById("content");
  main.replaceChildren(...(job ? scanPage(job, alone !== null) : batchPage()).filter(Boolean));
  const failed = JOBS.filter((each) => each.status === "failed").length;
  document.title = job ? `${job.label} · scanrender` : `${failed ? `${failed} failed · ` : ""}${DATA.title} · scanrender`;
}
window.addEventListener("hashchange", () => {
  if (location.hash && !location.hash.startsWith("#scan=")) return;
  show();
  window.scrollTo(0, 0);
  document.getElementById("content").focus({preventScroll: true});
});
show();
