// One scan: its turn, the viewer, times, the plan, settings, files.
function scanPage(job, alone) {
  const index = JOBS.indexOf(job), before = JOBS[index - 1], after = JOBS[index + 1];
  const failed = job.status === "failed";
  const slot = el("section", {"aria-label": "buffers"}, el("h2", {}, "Buffers"), el("div", {class: "card panel soft"}, "…"));
  if (!failed) layersOf(job).then(async (layers) => {
    const {unread} = await pixelsOf(job);
    const dumped = layers.some((layer) => layer.values);
    slot.replaceChildren(el("h2", {}, dumped ? "Buffers" : "Picture"), layers.length ? viewerOf(job, layers) : el("p", {class: "soft"}, "No picture was asked for."),
      unread.map((words) => el("p", {class: "warnings"}, words)),
      dumped ? "" : el("p", {class: "soft small", style: {marginTop: ".6rem"}}, "No buffers were dumped: ", el("code", {}, "--set outputs.buffers=[all]"), " shows everything behind the picture here."));
  });
  return [
    el("div", {class: "back"}, alone ? "" : el("a", {href: "#"}, "← all scans"),
      alone ? "" : el("nav", {"aria-label": "other scans"}, before ? el("a", {href: `#scan=${before.id}`, rel: "prev"}, `‹ ${before.label}`) : "", after ? el("a", {href: `#scan=${after.id}`, rel: "next"}, `${after.label} ›`) : "")),
    headOf(job.label, [badges(job), el("code", {}, job.scan)], alone),
    failed ? el("section", {style: {marginTop: "1.3rem"}}, failureOf(job)) : el("div", {class: "top"},
      el("div", {class: "card"}, turnOf(job, true)),
      el("div", {class: "card"}, el("div", {class: "words"}, warningsOf(job), factsOf(job), fidelityOf(job)))),
    failed ? "" : slot,
    timesOf(job), planOf(job), failed ? "" : filesOf(job), settingsTable(job), footer(),
  ];
}

function fidelityOf(job) {
  const lost = job.lost, units = job.units;
  if (!lost) return "";
  const rows = [];
  const distance = (name, label) => lost[name] && rows.push([label, ["mean", "p99", "max"].map((key) => mm(lost[name][key]))]);
  distance("prepared_to_raw_mm", "prepared to raw, mm");
  distance("raw_to_prepared_mm", "raw to prepared, mm");
  const colour = lost.color_de2000;
  if (colour) rows.push(["colour, dE2000", ["mean", "p99", "max"].map((key) => (colour[key] === undefined ? "" : number(colour[key], 2)))]);
  const words = [
    lost.normal_deviation_deg ? `normals turn by ${number(lost.normal_deviation_deg, 2)}° on average` : "",
    lost.stretch ? `${number(100 * lost.stretch.within_1_5, 4)} % of texels within 1.5× of ${number(lost.stretch.median_px_per_mm, 3)} px/mm` : "",
    lost.flipped_triangles ? `${lost.flipped_triangles} flipped triangles` : "",
  ].filter(Boolean);
  return el("div", {}, el("h3", {}, "Lost in preparation"),
    el("table", {class: "list"}, el("thead", {}, el("tr", {}, el("th", {}, ""), ["mean", "99 %", "max"].map((word) => el("th", {class: "right"}, word)))),
      el("tbody", {}, rows.map(([name, cells]) => el("tr", {}, el("td", {}, name), cells.map((cell) => el("td", {class: "right"}, cell)))))),
    words.length ? el("p", {class: "small soft", style: {marginTop: ".5rem"}}, words.join(" · ")) : "",
    units ? el("p", {class: "small soft"}, `1 unit is ${number(units.mm_per_unit)} mm: ${units.reason}`) : "");
}

function timesOf(job) {
  const rows = Object.entries(job.seconds || {}).map(([name, value]) => ({name, value}));
  const prep = (job.prep_stages || []).map(({name, seconds: value, mib}) => ({name, value, note: mib ? `· ${Math.round(mib)} MiB` : ""}));
  const frames = frameTimes(job);
  if (!rows.length && !prep.length && !frames) return "";
  return el("section", {"aria-label": "times"}, el("h2", {}, "Time"), el("div", {class: "pair"},
    rows.length || frames ? el("section", {class: "card"}, el("h3", {}, "Stages"), rows.length ? bars(rows, "seconds per stage") : "", frames ? [el("h3", {class: "next"}, "Frames"), frames] : "") : "",
    prep.length ? el("section", {class: "card"}, el("h3", {}, "Preparation"), bars(prep, "seconds per step of preparation")) : ""));
}

function planOf(job) {
  const findings = (job.plan || {}).findings || [], reasons = job.not_run || [], quality = job.quality || {};
  if (!findings.length && !reasons.length && !quality.picked) return "";
  const saved = (job.plan || {}).asked_ms;
  return el("section", {"aria-label": "plan"}, el("h2", {}, "Plan"), el("div", {class: "card panel"},
    quality.picked ? el("p", {}, el("b", {}, quality.picked), quality.satisfies ? "" : " (the nearest there is)", `: predicted dE2000 ${number(quality.predicted_delta_e, 3)} to truth and ${number(quality.predicted_ms, 3)} ms a frame`, quality.measured_ms ? `, took ${number(quality.measured_ms, 3)} ms` : "") : "",
    saved ? el("p", {}, `A frame takes ${number(job.plan.planned_ms, 3)} ms instead of ${number(saved, 3)} ms; the picture changes by dE2000 ${number(job.plan.delta_e, 2)}.`) : "",
    findings.length ? el("table", {class: "list"}, el("thead", {}, el("tr", {}, ["decision", "", "dE2000", "tolerance"].map((word, column) => el("th", {class: column > 1 ? "right" : ""}, word)))),
      el("tbody", {}, findings.map((found) => el("tr", {}, el("td", {}, found.what), el("td", {}, found.left_out ? "left out" : "kept"), el("td", {class: "right"}, number(found.delta_e, 2)), el("td", {class: "right"}, number(found.tolerance, 2)))))) : "",
    reasons.length ? [el("h3", {style: {marginTop: findings.length ? "1rem" : 0}}, "Not run"), el("ul", {class: "reasons"}, reasons.map((words) => {
      const at = words.indexOf(": ");
      return el("li", {}, at > 0 ? [el("b", {}, words.slice(0, at)), words.slice(at)] : words);
    }))] : ""));
}

function filesOf(job) {
  return job.downloads.length ? el("section", {"aria-label": "files"}, el("h2", {}, "Files"), el("ul", {class: "files"},
    job.downloads.map((file) => el("li", {}, el("a", {href: file.href}, file.name, el("small", {}, `${file.label} · ${bytes(file.bytes)}`)))))) : "";
}

function flat(value, path = "") {
  if (value === null || typeof value !== "object") return [[path, value === null ? "–" : value]];
  if (Array.isArray(value) && value.every((item) => item === null || typeof item !== "object")) return [[path, value.length ? value.join(", ") : "–"]];
  return Object.entries(value).flatMap(([key, inner]) => flat(inner, path ? `${path}.${key}` : key));
}

function settingsTable(job) {
  const usual = new Map(flat(DATA.defaults)), rows = flat(settingsOf(job));
  if (!rows.length) return "";
  const differs = ([key, value]) => String(usual.get(key)) !== String(value);
  const body = el("tbody", {}, rows.map((row) => el("tr", {class: differs(row) ? "differs" : "", hidden: !differs(row)}, el("td", {class: "mono"}, row[0]), el("td", {class: "mono"}, String(row[1])), el("td", {class: "mono soft"}, differs(row) && usual.has(row[0]) ? String(usual.get(row[0])) : ""))));
  const every = el("input", {type: "checkbox", on: {change: () => { for (const row of body.children) row.hidden = !every.checked && !row.classList.contains("differs"); }}});
  return el("section", {"aria-label": "settings"}, el("div", {class: "bar", style: {margin: "2.5rem 0 .9rem"}}, el("h2", {}, "Settings"), el("label", {class: "small"}, every, ` all ${rows.length}, not only what differs from the defaults`)),
    el("div", {class: "card panel scroll", tabindex: 0, role: "region", "aria-label": "settings"}, el("table", {class: "list"}, el("thead", {}, el("tr", {}, ["key", "value", "default"].map((word) => el("th", {}, word)))), body)));
}
