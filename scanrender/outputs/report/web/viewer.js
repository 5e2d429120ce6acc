// Two pictures on one stage: switch, zoom, pan, slide one over the other, read values off.
async function inflated(values) {
  const packed = Uint8Array.from(atob(values.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const plain = new Uint8Array(await new Response(stream).arrayBuffer());
  const {width, height, ranges} = values, size = width * height * ranges.length;
  const codes = new Uint16Array(size);
  for (let row = 0; row < size; row += width)
    for (let x = 0, code = 0; x < width; x++) {
      code = (code + (plain[row + x] << 8) + plain[size + row + x]) & 65535;
      codes[row + x] = code;
    }
  return codes;
}

/** Numbers of a layer at a pixel of its buffer: {x, y, values}, of the nearest pixel that is kept. */
async function valuesAt(layer, x, y) {
  if (!layer.values) return coloursAt(layer, x, y);
  const {step, width, height, ranges} = layer.values;
  if (!layer.codes) layer.codes = inflated(layer.values).catch(() => null);
  const codes = await layer.codes;
  if (!codes) return {x, y, values: null};
  const column = Math.min(width - 1, Math.floor(x / step)), row = Math.min(height - 1, Math.floor(y / step));
  const values = ranges.map(([low, high], channel) => {
    const code = codes[(channel * height + row) * width + column];
    return code === 0 ? null : code === 1 ? NaN : low + (high - low) * (code - 2) / 65533;
  });
  return {x: column * step, y: row * step, values};
}

/** A picture without numbers has its colours: data: URIs may be read back, also on file://. */
async function coloursAt(layer, x, y) {
  if (!layer.canvas) {
    const image = new Image();
    image.src = layer.picture;
    await image.decode();
    const canvas = el("canvas", {width: image.naturalWidth, height: image.naturalHeight});
    canvas.getContext("2d", {willReadFrequently: true}).drawImage(image, 0, 0);
    layer.canvas = canvas;
  }
  const {canvas} = layer, at = (value, from, to) => Math.min(to - 1, Math.floor(value * to / from));
  const pixel = canvas.getContext("2d").getImageData(at(x, layer.width, canvas.width), at(y, layer.height, canvas.height), 1, 1).data;
  return {x, y, values: [...pixel.slice(0, 3)].map((value) => value / 255)};
}

/** What can be looked at of a job: its buffers, and the first frame of its turn. */
async function layersOf(job) {
  const pixels = await pixelsOf(job);
  if (pixels.all) return pixels.all;
  const layers = pixels.layers.map((layer) => ({...layer, title: layer.name + (layer.frame ? `, frame ${layer.frame}` : "")}));
  const still = pixels.turn.still || pixels.page;
  if (still) {
    const image = new Image();
    image.src = still;
    await image.decode();
    layers.unshift({
      title: pixels.turn.still ? "picture" : "sheet", name: "picture", unit: "no unit", space: "sRGB display", picture: still,
      width: image.naturalWidth, height: image.naturalHeight, bars: [], remarks: [], channels: ["R", "G", "B"],
      meaning: pixels.turn.still ? "The first frame of the turn, reduced for this page." : "What was drawn of this scan.",
    });
  }
  pixels.all = layers;
  return layers;
}

/** Other jobs whose layers may lie on the right: the same scan's first. */
function othersOf(job) {
  const rest = JOBS.filter((other) => other !== job && other.pixels);
  return [...rest.filter((other) => other.scan === job.scan), ...rest.filter((other) => other.scan !== job.scan)].slice(0, 60);
}

function viewerOf(job, layers) {
  const view = {scale: 1, x: 0, y: 0, split: 50, probe: null};
  const sides = {a: sideOf("a"), b: sideOf("b")};
  let left = layers[0], right = null, rightJob = job;

  const edge = el("div", {class: "edge", hidden: true}), grip = el("div", {class: "grip", hidden: true});
  const cross = el("div", {class: "cross", hidden: true});
  const stage = el("div", {class: "stage", tabindex: 0, role: "application", "aria-label": "buffer viewer: arrow keys move the probe, plus and minus zoom, 0 fits, Shift and arrows pan, N and P change the buffer"},
    sides.a.box, sides.b.box, edge, grip, cross, sides.a.tag, sides.b.tag);
  const slider = el("input", {type: "range", min: 0, max: 100, step: 0.5, value: 50, disabled: true, "aria-label": "how much of A is shown"});
  const chooseA = el("select", {"aria-label": "A"}, layers.map((layer, index) => el("option", {value: index}, layer.title)));
  const chooseB = el("select", {"aria-label": "B"}, el("option", {value: ""}, "nothing"),
    [job, ...othersOf(job)].map((other) => el("optgroup", {label: other === job ? "this scan" : other.label, "data-job": other.id},
      other === job ? layers.map((layer, index) => el("option", {value: `${job.id}/${index}`}, layer.title))
        : el("option", {value: `${other.id}/same`}, "the same as A"))));
  const readout = el("div", {"aria-live": "polite"}), place = el("div", {class: "soft"}, "point at the picture, or click it and use the arrow keys"), legend = el("div", {class: "legend", "aria-live": "polite"});
  const zoomed = el("span", {class: "small soft num"}, "fit");

  function sideOf(name) {
    const image = el("img", {alt: "", draggable: "false"});
    return {image, box: el("div", {class: "side", "data-side": name}, image), tag: el("span", {class: "tag", style: name === "a" ? {left: ".6rem"} : {right: ".6rem"}})};
  }

  // The picture's place at scale 1: as large as fits.
  function fit() {
    const {clientWidth: width, clientHeight: height} = stage;
    const share = Math.min(width / left.width, height / left.height);
    return {share, x: (width - left.width * share) / 2, y: (height - left.height * share) / 2};
  }
  function draw() {
    const at = fit(), size = at.share * view.scale;
    for (const [side, layer] of [[sides.a, left], [sides.b, right]]) {
      if (!layer) continue;
      Object.assign(side.image.style, {
        width: `${left.width * at.share}px`, height: `${left.height * at.share}px`,
        transform: `translate(${at.x * view.scale + view.x}px, ${at.y * view.scale + view.y}px) scale(${view.scale})`,
      });
    }
    stage.classList.toggle("zoomed", view.scale > 1);
    stage.classList.toggle("close", size > 2);
    sides.b.box.style.clipPath = `inset(0 0 0 ${view.split}%)`;
    for (const mark of [edge, grip]) { mark.hidden = !right; mark.style.left = `${view.split}%`; }
    sides.b.box.hidden = sides.b.tag.hidden = !right;
    zoomed.textContent = view.scale === 1 ? "fit" : `${number(size, 2)} × pixels`;
    if (view.probe) {
      cross.hidden = false;
      cross.style.left = `${at.x * view.scale + view.x + (view.probe.x + .5) * size}px`;
      cross.style.top = `${at.y * view.scale + view.y + (view.probe.y + .5) * size}px`;
    }
  }
  function zoomTo(scale, x = stage.clientWidth / 2, y = stage.clientHeight / 2) {
    const next = Math.min(64, Math.max(1, scale)), ratio = next / view.scale;
    view.x = x - (x - view.x) * ratio;
    view.y = y - (y - view.y) * ratio;
    view.scale = next;
    pan(0, 0);
  }
  function pan(dx, dy) {
    const {clientWidth: width, clientHeight: height} = stage;
    // The stage at this scale never leaves the stage: the picture cannot be lost.
    view.x = Math.min(0, Math.max(width * (1 - view.scale), view.x + dx));
    view.y = Math.min(0, Math.max(height * (1 - view.scale), view.y + dy));
    draw();
  }
  function split(percent) {
    view.split = Math.min(100, Math.max(0, percent));
    slider.value = view.split;
    draw();
  }

  let asked = 0;
  async function probe(x, y) {
    view.probe = {x: Math.min(left.width - 1, Math.max(0, Math.floor(x))), y: Math.min(left.height - 1, Math.max(0, Math.floor(y)))};
    draw();
    const mine = ++asked, rows = [];
    for (const [name, layer] of [["A", left], ["B", right]]) {
      if (!layer) continue;
      const found = await valuesAt(layer, Math.floor(view.probe.x * layer.width / left.width), Math.floor(view.probe.y * layer.height / left.height));
      rows.push([name, layer, found]);
    }
    if (mine !== asked) return;
    const [, first, at] = rows[0], step = first.values ? first.values.step : 1;
    place.textContent = `pixel ${at.x}, ${at.y}${step > 1 ? ` (of each ${step} × ${step} one is kept)` : ""}`;
    readout.replaceChildren(...rows.map(([name, layer, found]) => el("div", {class: "row"}, el("span", {class: "soft"}, right ? `${name}  ${layer.title}` : layer.title), words(layer, found))));
  }
  function words(layer, {values}) {
    if (!values) return el("div", {}, "this browser cannot unpack values");
    if (values.every((value) => value === null)) return el("div", {}, "no surface");
    const unit = layer.unit.length > 6 ? "" : layer.unit; // longer ones are sentences of the legend
    return el("div", {class: "numbers", "data-values": values.join(" ")},
      values.map((value, index) => el("span", {}, el("i", {}, layer.channels[index]), value === null ? "–" : number(value))), el("span", {class: "soft"}, unit));
  }

  function legendOf(layer) {
    return [
      el("div", {class: "name"}, layer.title), el("div", {class: "soft"}, `${layer.unit} · ${layer.space}`),
      el("p", {class: "soft"}, layer.meaning),
      layer.bars.map((bar) => el("div", {},
        el("div", {class: "ramp", style: {background: `linear-gradient(90deg, ${bar.colours.join(",")})`}}),
        el("div", {class: "ticks"}, bar.ticks.map((tick, index) => el("span", {}, index === 0 && bar.label ? `${bar.label[0]}  ${tick}` : tick))))),
      layer.remarks.length ? el("p", {class: "soft"}, layer.remarks.join(" · ")) : "",
      layer.healthy ? el("p", {}, el("span", {class: "soft"}, "Healthy: "), layer.healthy) : "",
    ];
  }
  function refresh() {
    sides.a.image.src = left.picture;
    sides.a.image.alt = `${left.title} of ${job.label}`;
    sides.a.tag.textContent = right ? `A  ${left.title}` : left.title;
    if (right) {
      sides.b.image.src = right.picture;
      sides.b.image.alt = `${right.title} of ${rightJob.label}`;
      sides.b.tag.textContent = `B  ${right.title}${rightJob === job ? "" : `, ${rightJob.label}`}`;
    }
    slider.disabled = !right;
    legend.replaceChildren(...[legendOf(left), right && right.title !== left.title ? legendOf(right) : ""].flat(9).filter(Boolean));
    draw();
    if (view.probe) probe(view.probe.x, view.probe.y);
  }
  async function setB(value) {
    const [id, which] = value.split("/");
    rightJob = byId.get(id) || job;
    right = null;
    if (value) {
      const found = await layersOf(rightJob);
      if (rightJob !== job) fillGroup(rightJob, found);
      const same = found.findIndex((layer) => layer.title === left.title);
      const index = which === "same" ? Math.max(0, same) : Number(which);
      right = found[index] || null;
      chooseB.value = `${id}/${index}`;
    }
    refresh();
  }
  function fillGroup(other, found) {
    const group = [...chooseB.querySelectorAll("optgroup")].find((each) => each.dataset.job === other.id);
    if (group.children.length === 1) group.replaceChildren(...found.map((layer, index) => el("option", {value: `${other.id}/${index}`}, layer.title)));
  }
  function setA(index) {
    left = layers[(index % layers.length + layers.length) % layers.length];
    chooseA.value = layers.indexOf(left);
    refresh();
  }

  chooseA.addEventListener("change", () => setA(Number(chooseA.value)));
  chooseB.addEventListener("change", () => setB(chooseB.value));
  slider.addEventListener("input", () => split(Number(slider.value)));
  const local = (event) => { const box = stage.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  const fingers = new Map();
  let moved = false, sliding = false;
  stage.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, local(event));
    moved = false;
    sliding = event.target === grip;
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    const now = local(event), before = fingers.get(event.pointerId);
    if (before && sliding) split(100 * now[0] / stage.clientWidth);
    else if (before && fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
      zoomTo(view.scale * apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if (before && view.scale > 1) { pan(now[0] - before[0], now[1] - before[1]); moved = true; }
    if (before) fingers.set(event.pointerId, now);
    if (!sliding && !moved && fingers.size < 2) probeAt(now);
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, (event) => { fingers.delete(event.pointerId); if (!fingers.size) sliding = moved = false; });
  function probeAt([x, y]) {
    const at = fit(), size = at.share * view.scale;
    const px = (x - view.x - at.x * view.scale) / size, py = (y - view.y - at.y * view.scale) / size;
    if (px >= 0 && py >= 0 && px < left.width && py < left.height) probe(px, py);
  }
  stage.addEventListener("dblclick", (event) => zoomTo(view.scale > 1 ? 1 : 4, ...local(event)));
  stage.addEventListener("wheel", (event) => {
    // The wheel scrolls the page until the stage was clicked, or Ctrl is held (a pinch is that too).
    if (!event.ctrlKey && document.activeElement !== stage) return;
    event.preventDefault();
    zoomTo(view.scale * Math.exp(-event.deltaY * (event.ctrlKey ? .01 : .002)), ...local(event));
  }, {passive: false});
  stage.addEventListener("keydown", (event) => {
    const arrow = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (arrow && event.shiftKey) pan(-60 * arrow[0], -60 * arrow[1]);
    else if (arrow) {
      const step = left.values ? left.values.step : 1, from = view.probe || {x: left.width / 2, y: left.height / 2};
      probe(from.x + step * arrow[0], from.y + step * arrow[1]);
    } else if (event.key === "+" || event.key === "=") zoomTo(view.scale * 1.5);
    else if (event.key === "-") zoomTo(view.scale / 1.5);
    else if (event.key === "0") zoomTo(1);
    else if (event.key === "n" || event.key === "p") setA(layers.indexOf(left) + (event.key === "n" ? 1 : -1));
    else return;
    event.preventDefault();
  });
  new ResizeObserver(() => pan(0, 0)).observe(stage);

  const node = el("div", {class: "card viewer"}, stage, el("div", {class: "controls", tabindex: -1},
    el("label", {}, "A, on the left", chooseA), el("label", {}, "B, on the right", chooseB),
    el("label", {}, "A ⟷ B", slider),
    el("div", {class: "zoom"},
      el("button", {type: "button", "aria-label": "zoom out", on: {click: () => zoomTo(view.scale / 1.5)}}, "−"),
      el("button", {type: "button", "aria-label": "zoom in", on: {click: () => zoomTo(view.scale * 1.5)}}, "+"),
      el("button", {type: "button", on: {click: () => zoomTo(1)}}, "Fit"), zoomed),
    el("div", {class: "readout"}, place, readout), legend));
  // What people look for first is the picture; where `display` was dumped, with its numbers.
  const first = layers.findIndex((layer) => layer.name === "display");
  setA(Math.max(0, first));
  return node;
}
