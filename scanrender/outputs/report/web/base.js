// What every part uses: the data, elements (text is only ever set as text), words, pictures.
const DATA = JSON.parse(document.getElementById("data").textContent);
const JOBS = DATA.jobs;
const byId = new Map(JOBS.map((job) => [job.id, job]));

function put(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "on") for (const [event, call] of Object.entries(value)) node.addEventListener(event, call);
    else if (name === "style") Object.assign(node.style, value);
    else node.setAttribute(name, value === true ? "" : value);
  }
  for (const child of children.flat(9)) if (child !== null && child !== undefined && child !== "") node.append(child);
  return node;
}
const el = (tag, attributes, ...children) => put(document.createElement(tag), attributes, children);
const svg = (tag, attributes, ...children) => put(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);

function seconds(value) {
  if (value < 60) return `${value < 10 ? value.toFixed(1) : Math.round(value)} s`;
  const minutes = Math.round(value / 60);
  return minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}
function bytes(value) {
  for (const [size, unit] of [[1e9, "GB"], [1e6, "MB"], [1e3, "kB"]])
    if (value >= size) return `${(value / size).toFixed(value < 10 * size ? 1 : 0)} ${unit}`;
  return `${value} bytes`;
}
function number(value, digits = 4) {
  if (typeof value !== "number") return String(value);
  if (!Number.isFinite(value)) return "not finite";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(2);
  return String(Number(value.toPrecision(digits)));
}
/** A length that was lost: below a micrometre there is nothing to tell. */
const mm = (value) => (value < 0.001 ? "< 0.001" : number(value, 2));
const total = (job) => Object.values(job.seconds || {}).reduce((sum, value) => sum + value, 0);
function median(values) {
  const sorted = [...values].sort((a, b) => a - b), middle = sorted.length >> 1;
  return sorted.length ? (sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2) : null;
}
const settingsOf = (job) => DATA.settings[job.variant || ""] || {};
function angleOf(job, frame) {
  const turn = settingsOf(job).turntable || {};
  return (turn.start_deg || 0) + (turn.degrees ?? 360) * frame / (turn.frames || 1);
}

// A job's pictures: in this file, or in a script beside it (a page opened from the file system may
// load scripts, but read no other file).
const waiting = new Map(), loaded = new Map();
window.scanrenderPixels = (key, pixels) => { (waiting.get(key) || (() => {}))(pixels); };
function pixelsOf(job) {
  if (!loaded.has(job.id)) loaded.set(job.id, load(job));
  return loaded.get(job.id);
}
function load(job) {
  const inside = document.getElementById(`pixels-${job.id}`);
  if (inside) return Promise.resolve(JSON.parse(inside.textContent));
  if (!job.pixels) return Promise.resolve({turn: {}, layers: [], page: "", unread: []});
  const key = job.pixels.replace(/^.*-|\.js$/g, "");
  return new Promise((resolve) => {
    const lost = () => resolve({turn: {}, layers: [], page: "", unread: [`${job.pixels} is not beside this page`]});
    waiting.set(key, resolve);
    const script = el("script", {src: job.pixels, on: {error: lost}});
    document.head.append(script);
  });
}
