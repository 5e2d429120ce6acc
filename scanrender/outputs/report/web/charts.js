// Times as inline SVG.
const colourOf = (index) => `var(--c${index % 8})`;

/** Horizontal bars, one a row: [{name, value, note}]. */
function bars(rows, title, format = seconds) {
  const most = Math.max(...rows.map((row) => row.value), 1e-9), line = 30, width = 420;
  return svg("svg", {viewBox: `0 0 ${width} ${rows.length * line}`, role: "img", "aria-label": `${title}: ${rows.map((row) => `${row.name} ${format(row.value)}`).join(", ")}`},
    rows.map((row, index) => [
      svg("text", {x: 0, y: index * line + 19}, row.name),
      svg("rect", {class: "track", x: 130, y: index * line + 8, width: 180, height: 14, rx: 4}),
      svg("rect", {x: 130, y: index * line + 8, width: Math.max(2, 180 * row.value / most), height: 14, rx: 4, fill: colourOf(index)}),
      svg("text", {x: width, y: index * line + 19, "text-anchor": "end"}, format(row.value), row.note ? svg("tspan", {class: "soft"}, ` ${row.note}`) : ""),
    ]));
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
  const stages = [...new Set(rows.flatMap((job) => Object.keys(job.seconds)))], most = total(rows[0]), line = 30;
  return el("figure", {},
    svg("svg", {viewBox: `0 0 900 ${rows.length * line}`, role: "img", "aria-label": `time of each scan: ${rows.map((job) => `${job.label} ${seconds(total(job))}`).join(", ")}`, class: "wide"},
      rows.map((job, index) => {
        let x = 230;
        return [
          svg("text", {x: 0, y: index * line + 19}, job.label.length > 32 ? `${job.label.slice(0, 31)}…` : job.label),
          stages.map((stage, which) => {
            const width = 590 * (job.seconds[stage] || 0) / most, from = x;
            x += width;
            return svg("rect", {x: from, y: index * line + 7, width, height: 16, fill: colourOf(which)}, svg("title", {}, `${stage} ${seconds(job.seconds[stage] || 0)}`));
          }),
          svg("text", {x: 900, y: index * line + 19, "text-anchor": "end"}, seconds(total(job))),
        ];
      })),
    el("figcaption", {class: "keys"}, stages.map((stage, which) => el("span", {}, el("i", {style: {background: colourOf(which)}}), stage)),
      jobs.length > rows.length && rows.length === 20 ? el("span", {}, `the 20 that took longest of ${jobs.length}`) : ""));
}
