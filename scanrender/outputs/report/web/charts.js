// Times as inline SVG.
const colourOf = (index) => `var(--c${index % 8})`;

/** One bar of parts [{value, colour, title}], as long as `most` allows; words stay out of it, so that
    they are as large on a phone. */
function barOf(parts, most) {
  let x = 0;
  return svg("svg", {viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true"},
    svg("rect", {class: "track", width: 100, height: 10}),
    parts.map(({value, colour, title}) => {
      const from = x, width = 100 * value / most;
      x += width;
      return svg("rect", {x: from, width, height: 10, fill: colour}, svg("title", {}, title));
    }));
}

/** Horizontal bars, one a row: [{name, value, note}]. */
function bars(rows, title) {
  const most = Math.max(...rows.map((row) => row.value), 1e-9);
  return el("dl", {class: "bars", "aria-label": title}, rows.map((row, index) => el("div", {},
    el("dt", {}, row.name), barOf([{value: row.value, colour: colourOf(index), title: seconds(row.value)}], most),
    el("dd", {}, seconds(row.value), row.note ? el("span", {class: "soft"}, ` ${row.note}`) : ""))));
}

/** A column for each frame: what it took. */
function frameTimes(job) {
  const times = Object.entries(job.frame_ms || {}).map(([frame, value]) => [Number(frame), value]).sort((a, b) => a[0] - b[0]);
  if (times.length < 2) return null;
  const width = 420, height = 110, most = Math.max(...times.map(([, value]) => value)), step = width / times.length;
  const middle = median(times.map(([, value]) => value));
  return el("figure", {},
    svg("svg", {viewBox: `0 0 ${width} ${height + 4}`, role: "img", "aria-label": `milliseconds of each frame, median ${number(middle, 3)}`},
      times.map(([frame, value], index) => svg("rect", {x: index * step, y: height - height * value / most, width: Math.max(.6, step * .8), height: height * value / most, rx: Math.min(2, step * .3), fill: "var(--c2)"},
        svg("title", {}, `frame ${frame}: ${number(value, 4)} ms`))),
      svg("line", {x1: 0, x2: width, y1: height - height * middle / most, y2: height - height * middle / most, stroke: "var(--accent)", "stroke-dasharray": "4 4"})),
    el("figcaption", {class: "small soft"}, `each of ${times.length} frames: median ${number(middle, 3)} ms (dashed), most ${number(most, 3)} ms`));
}

/** Where the time of a batch went: a stacked bar for each of the scans that took longest. */
function batchTimes(jobs) {
  const rows = jobs.filter((job) => total(job) > 0).sort((a, b) => total(b) - total(a)).slice(0, 20);
  if (!rows.length) return null;
  const stages = [...new Set(rows.flatMap((job) => Object.keys(job.seconds)))], most = total(rows[0]);
  return el("figure", {},
    el("dl", {class: "bars wide", "aria-label": "time of each scan"}, rows.map((job) => el("div", {}, el("dt", {}, job.label),
      barOf(stages.map((stage, which) => ({value: job.seconds[stage] || 0, colour: colourOf(which), title: `${stage} ${seconds(job.seconds[stage] || 0)}`})), most),
      el("dd", {}, seconds(total(job)))))),
    el("figcaption", {class: "keys"}, stages.map((stage, which) => el("span", {}, el("i", {style: {background: colourOf(which)}}), stage)),
      jobs.length > rows.length && rows.length === 20 ? el("span", {}, `the 20 that took longest of ${jobs.length}`) : ""));
}
