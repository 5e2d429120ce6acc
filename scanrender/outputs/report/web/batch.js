// The batch: failures first, then a card for each scan.
/** Jobs of one scan that failed for one reason are one failure. */
function failuresOf(jobs) {
  const groups = new Map();
  for (const job of jobs) {
    const same = JSON.stringify([job.scan, (job.error || {}).what, (job.error || {}).where]);
    groups.set(same, [...(groups.get(same) || []), job]);
  }
  return [...groups.values()].map((group) => failureOf(...group));
}

function failureOf(job, ...others) {
  const {what, where, fix, exit_code: code} = job.error || {};
  const name = others.length ? `${job.name}: ${[job, ...others].map((each) => each.variant).join(", ")}` : job.label;
  return el("article", {class: "card failure"},
    el("div", {class: "head"}, el("h3", {}, name), el("span", {class: "badge failed"}, "failed")),
    el("p", {class: "what"}, what),
    el("dl", {},
      where ? [el("dt", {}, "where"), el("dd", {class: "mono"}, where)] : "",
      fix ? [el("dt", {}, "to do"), el("dd", {class: "todo"}, fix)] : "",
      where === job.scan ? "" : [el("dt", {}, "scan"), el("dd", {class: "mono"}, job.scan)],
      el("dt", {}, "exit code"), el("dd", {}, `${code}`),
      job.downloads.map((file) => [el("dt", {}, file.label), el("dd", {}, el("a", {href: file.href}, file.name))])));
}

function factsOf(job) {
  const facts = [];
  const spent = total(job), frame = median(Object.values(job.frame_ms || {})), lost = job.lost || {};
  if (spent) facts.push(["time", seconds(spent)]);
  if (frame !== null) facts.push(["a frame", `${number(frame, 3)} ms`]);
  if (lost.symmetric_mm) facts.push(["shape lost, 99 %", `${mm(lost.symmetric_mm.p99)} mm`]);
  if (lost.color_de2000) facts.push(["colour lost, mean", `dE ${number(lost.color_de2000.mean, 2)}`]);
  if (lost.charts) facts.push(["charts", `${lost.charts}, ${Math.round(100 * lost.atlas_use)} % used`]);
  if (job.counts && job.counts.prepared) facts.push(["triangles", job.counts.prepared.triangles.toLocaleString("en")]);
  return el("dl", {class: "facts"}, facts.map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}

function warningsOf(job) {
  const found = job.warnings || [];
  return found.length ? el("ul", {class: "warnings"}, found.map((words) => el("li", {}, el("b", {}, "warning "), words))) : "";
}

const STATUS = {done: "done", cached: "complete before", failed: "failed"};
function badges(job) {
  return el("span", {class: `badge ${job.status}`}, STATUS[job.status] || job.status);
}

function cardOf(job) {
  return el("li", {class: "card", "data-name": job.label.toLowerCase()}, turnOf(job),
    el("div", {class: "words"},
      el("div", {class: "head"}, el("h3", {}, el("a", {href: `#scan=${job.id}`}, job.label)), badges(job)),
      factsOf(job), warningsOf(job),
      el("a", {class: "open", href: `#scan=${job.id}`, "aria-label": `Open ${job.label}`}, "Open →")));
}

function batchPage() {
  const failed = JOBS.filter((job) => job.status === "failed"), fine = JOBS.filter((job) => job.status !== "failed");
  const warned = fine.filter((job) => (job.warnings || []).length).length;
  const list = el("ul", {class: "cards"}, fine.map(cardOf));
  const empty = el("p", {class: "soft", hidden: true}, "No scan is called that.");
  const search = el("input", {type: "search", placeholder: "Find a scan", "aria-label": "Find a scan", on: {input: () => {
    const words = search.value.toLowerCase();
    let shown = 0;
    for (const card of list.children) shown += !(card.hidden = !card.dataset.name.includes(words));
    empty.hidden = shown > 0;
  }}});
  const times = batchTimes(JOBS);
  return [
    headOf(DATA.title, [
      el("span", {}, el("b", {}, `${fine.length} of ${JOBS.length}`), " complete"),
      failed.length ? el("span", {class: "badge failed"}, `${failed.length} failed`) : "",
      warned ? el("span", {class: "badge warned"}, `${warned} with warnings`) : "",
    ]),
    failed.length ? el("section", {"aria-label": "failures"}, el("h2", {}, "What failed"), failuresOf(failed)) : "",
    fine.length ? el("section", {"aria-label": "scans"},
      el("div", {class: "bar", style: {marginTop: "2.5rem"}}, el("h2", {}, "Scans"), fine.length > 6 ? search : ""), list, empty) : "",
    times ? el("section", {class: "card panel", style: {marginTop: "2.5rem"}}, el("h2", {}, "Where the time went"), times) : "",
    footer(),
  ];
}

/** `ended`: say when the run ended and how long it took. */
function headOf(title, words, ended = true) {
  const finished = ended && DATA.finished ? new Date(DATA.finished.replace(/([+-]\d\d)(\d\d)$/, "$1:$2")) : null;
  return el("header", {}, el("h1", {}, title), el("p", {class: "lead"}, words,
    finished && !Number.isNaN(finished.getTime()) ? el("span", {}, "finished ", el("b", {}, finished.toLocaleString([], {dateStyle: "medium", timeStyle: "short"}))) : "",
    ended && DATA.seconds ? el("span", {}, "took ", el("b", {}, seconds(DATA.seconds))) : ""));
}

function footer() {
  const gl = JOBS.map((job) => (job.gl || {}).renderer).find(Boolean), machine = DATA.platform || {};
  const words = [`scanrender ${DATA.scanrender}`, gl, machine.system, machine.cores ? `${machine.cores} cores` : "", machine.python ? `Python ${machine.python}` : ""];
  return el("footer", {}, words.filter(Boolean).join("  ·  "));
}
