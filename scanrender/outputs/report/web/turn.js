// A turntable to scrub: hover or drag, arrow keys, Home and End.
function turnOf(job, eager = false) {
  const strip = el("div", {class: "strip"}), angle = el("span", {class: "angle"}), at = el("span", {class: "at"});
  const box = el("div", {class: "turn", style: {aspectRatio: "1"}}, strip);
  if (job.poster) strip.append(el("img", {src: job.poster, alt: ""}));
  const fill = () => pixelsOf(job).then((pixels) => show(pixels));
  if (eager || !("IntersectionObserver" in window)) fill();
  else {
    const seen = new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) { seen.disconnect(); fill(); }
    }, {rootMargin: "300px"});
    seen.observe(box);
  }

  function show({turn, page, unread}) {
    strip.replaceChildren();
    if (!turn.strip) {
      if (page) box.append(el("img", {src: page, alt: `pictures of ${job.label}`}));
      else box.append(el("p", {class: "none"}, unread[0] || "no frames, video or sheet was asked for"));
      return;
    }
    const count = turn.shown.length;
    Object.assign(strip.style, {
      backgroundImage: `url("${turn.strip}")`, backgroundSize: `${100 * turn.columns}% ${100 * turn.rows}%`,
      aspectRatio: `${turn.width} / ${turn.height}`,
    });
    if (turn.width > turn.height) Object.assign(strip.style, {height: "auto", width: "100%"});
    put(box, {tabindex: 0, role: "slider", "aria-label": `turntable of ${job.label}`, "aria-valuemin": 0, "aria-valuemax": count - 1}, [angle, at]);
    let now = 0;
    const go = (index) => {
      now = (index % count + count) % count;
      const column = now % turn.columns, row = Math.floor(now / turn.columns);
      strip.style.backgroundPosition = `${turn.columns > 1 ? 100 * column / (turn.columns - 1) : 0}% ${turn.rows > 1 ? 100 * row / (turn.rows - 1) : 0}%`;
      const words = `${Math.round(angleOf(job, turn.shown[now]))}°`;
      angle.textContent = words;
      at.style.width = `${100 * (now + 1) / count}%`;
      box.setAttribute("aria-valuenow", now);
      box.setAttribute("aria-valuetext", `${words}, frame ${turn.shown[now]}`);
    };
    const follow = (event) => {
      const {left, width} = box.getBoundingClientRect();
      go(Math.min(count - 1, Math.max(0, Math.floor(count * (event.clientX - left) / width))));
    };
    box.addEventListener("pointermove", follow);
    box.addEventListener("pointerdown", follow);
    box.addEventListener("keydown", (event) => {
      const to = {ArrowRight: now + 1, ArrowUp: now + 1, ArrowLeft: now - 1, ArrowDown: now - 1, Home: 0, End: count - 1}[event.key];
      if (to === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      go(to);
    });
    go(0);
  }
  return box;
}
