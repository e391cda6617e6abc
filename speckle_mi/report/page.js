"use strict";
// Numbers as people read them, with a true minus sign.
const words = (value, digits = 4) => value === null || !isFinite(value) ? "–"
  : String(Number(Number(value).toPrecision(digits))).replace("-", "−").replace("e+", "e");
const drawn = (tag, attributes, parent) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (parent) parent.append(made);
  return made;
};
const colours = ["var(--u)", "var(--v)"];

document.querySelector("#theme").addEventListener("click", () => {
  const root = document.documentElement, now = root.dataset.theme
    || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  root.dataset.theme = now === "dark" ? "light" : "dark";
});

function ticks(low, high, wanted) {
  const rough = (high - low) / wanted, unit = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(k => k * unit).find(k => k >= rough * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found.map(value => Math.abs(value) < 1e-9 * step ? 0 : value);
}

// A figure of panels over one another that share what runs to the right. Drag over a part to see it larger.
class Plot {
  constructor(figure) {
    this.figure = figure;
    this.spec = JSON.parse(figure.querySelector("script").textContent);
    this.view = 0;
    this.range = null;
    this.place = figure.querySelector(".canvas");
    this.readout = figure.querySelector(".readout");
    this.button = figure.querySelector(".reset");
    this.button.addEventListener("click", () => this.zoom(null));
    new ResizeObserver(() => this.draw()).observe(this.place);
    this.draw();
  }
  show(view) { this.view = view; this.draw(); }
  zoom(range) { this.range = range; this.button.hidden = range === null; this.draw(); }
  get panels() { return this.spec.views[Math.min(this.view, this.spec.views.length - 1)].panels; }
  draw() {
    const width = Math.max(this.place.clientWidth, 220), left = 62, right = 10, foot = 38, gap = 14;
    const heights = this.panels.map(panel => panel.height), height = heights.reduce((a, b) => a + b + gap, foot);
    const all = this.panels.flatMap(panel => panel.series.flatMap(one => one.x));
    const ends = this.range || this.spread([Math.min(...all), Math.max(...all)], 0.03);
    const toX = x => left + (x - ends[0]) / (ends[1] - ends[0]) * (width - left - right);
    const svg = drawn("svg", {viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": this.spec.title});
    this.scale = {toX, ends, left, right: width - right, bottom: height - foot, width};
    let top = gap / 2;
    const identity = "clip" + Math.random().toString(36).slice(2);
    const clip = drawn("clipPath", {id: identity}, svg);
    drawn("rect", {x: left, y: 0, width: width - left - right, height}, clip);
    for (const panel of this.panels) {
      this.panel(svg, panel, top, width, ends, toX, identity);
      top += panel.height + gap;
    }
    for (const value of ticks(...ends, Math.max(3, width / 90)))
      drawn("text", {x: toX(value), y: height - foot + 12, class: "tick", "text-anchor": "middle"}, svg)
        .textContent = words(value);
    drawn("text", {x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle"}, svg)
      .textContent = this.spec.x;
    this.cursor = drawn("line", {y1: 0, y2: height - foot, class: "cursor", visibility: "hidden"}, svg);
    this.chosen = drawn("rect", {y: 0, height: height - foot, class: "chosen", visibility: "hidden"}, svg);
    this.listen(svg);
    this.place.replaceChildren(svg);
    this.svg = svg;
    this.keys();
  }
  spread([low, high], margin) {
    const width = high - low || Math.abs(high) || 1;
    return [low - margin * width, high + margin * width];
  }
  panel(svg, panel, top, width, ends, toX, clip) {
    const {left, right} = this.scale, seen = [];
    for (const one of panel.series) one.x.forEach((x, k) => {
      if (x < ends[0] || x > ends[1]) return;
      for (const y of one.ys ? one.ys.map(line => line[k]) : [one.y[k]])
        if (y !== null && one.look !== "lost") seen.push(y - (one.e?.[k] || 0), y + (one.e?.[k] || 0));
    });
    if (panel.from !== undefined) seen.push(panel.from, panel.to);
    const [low, high] = this.spread(seen.length ? [Math.min(...seen), Math.max(...seen)] : [-1, 1], 0.07);
    const toY = y => top + panel.height - (y - low) / (high - low) * panel.height;
    for (const value of ticks(low, high, panel.height / 38)) {
      const y = toY(value);
      drawn("line", {x1: left, x2: right, y1: y, y2: y, class: value === 0 ? "zero" : "grid"}, svg);
      drawn("text", {x: left - 5, y: y + 4, class: "tick", "text-anchor": "end"}, svg).textContent = words(value);
    }
    const middle = top + panel.height / 2;
    drawn("text", {x: 0, y: 0, "text-anchor": "middle", transform: `translate(12 ${middle}) rotate(-90)`}, svg)
      .textContent = panel.y;
    const inside = drawn("g", {"clip-path": `url(#${clip})`}, svg);
    for (const one of panel.series) this.series(inside, one, toX, toY, top + panel.height);
  }
  series(parent, one, toX, toY, bottom) {
    const colour = one.look === "lost" ? "var(--lost)" : colours[one.hue % 2];
    const line = ys => {
      let path = "", down = false;
      one.x.forEach((x, k) => {
        if (ys[k] === null) { down = false; return; }
        path += `${down ? "L" : "M"}${toX(x).toFixed(2)} ${toY(ys[k]).toFixed(2)}`;
        down = true;
      });
      return path;
    };
    if (one.look === "thin") for (const ys of one.ys)
      drawn("path", {d: line(ys), class: "thin", stroke: colour}, parent);
    else if (one.look === "curve") drawn("path", {d: line(one.y), class: "curve", stroke: colour,
      ...(one.hue % 2 ? {"stroke-dasharray": "6 4"} : {})}, parent);
    else one.x.forEach((x, k) => {
      if (one.y[k] === null) return;
      const at = toX(x), y = one.look === "lost" ? bottom - 6 : toY(one.y[k]);
      if (one.look === "lost") {
        drawn("path", {d: `M${at - 4} ${y - 4}l8 8m0 -8l-8 8`, stroke: colour, "stroke-width": 1.8}, parent);
        return;
      }
      if (one.e?.[k]) drawn("line", {x1: at, x2: at, y1: toY(one.y[k] - one.e[k]), y2: toY(one.y[k] + one.e[k]),
        class: "bar", stroke: colour}, parent);
      this.mark(parent, at, y, one.hue, colour);
    });
  }
  mark(parent, x, y, hue, colour) {
    if (hue % 2) drawn("rect", {x: x - 3.2, y: y - 3.2, width: 6.4, height: 6.4, fill: "var(--card)", stroke: colour,
      "stroke-width": 1.7}, parent);
    else drawn("circle", {cx: x, cy: y, r: 3.6, fill: colour}, parent);
  }
  keys() {
    const key = this.figure.querySelector(".key");
    key.replaceChildren();
    const named = new Set();
    for (const one of this.panels.flatMap(panel => panel.series)) {
      if (!one.name || named.has(one.name)) continue;
      named.add(one.name);
      const item = document.createElement("span"), svg = drawn("svg", {viewBox: "0 0 26 12"}, item);
      this.series(svg, {...one, x: one.look === "curve" || one.look === "thin" ? [1, 25] : [13], y: [0, 0], e: null,
        ys: [[0, 0]]}, x => x, () => 6, 12);
      item.append(one.name);
      key.append(item);
    }
  }
  listen(svg) {
    const {left, right, ends} = this.scale;
    const place = event => {
      const box = svg.getBoundingClientRect(), x = (event.clientX - box.left) / box.width * this.scale.width;
      return Math.min(Math.max(x, left), right);
    };
    const back = x => ends[0] + (x - left) / (right - left) * (ends[1] - ends[0]);
    let from = null;
    svg.addEventListener("pointerdown", event => { from = place(event); this.read(back(from)); });
    svg.addEventListener("pointermove", event => {
      const x = place(event);
      this.read(back(x));
      if (from === null) return;
      this.chosen.setAttribute("x", Math.min(from, x));
      this.chosen.setAttribute("width", Math.abs(x - from));
      this.chosen.setAttribute("visibility", "visible");
    });
    const ended = event => {
      if (from === null) return;
      const x = place(event), pair = [from, x].sort((a, b) => a - b);
      from = null;
      this.chosen.setAttribute("visibility", "hidden");
      if (pair[1] - pair[0] > 12 && event.type === "pointerup") this.zoom(pair.map(back));
    };
    svg.addEventListener("pointerup", ended);
    svg.addEventListener("pointercancel", ended);
    svg.addEventListener("pointerleave", event => { ended(event); this.cursor.setAttribute("visibility", "hidden"); });
    svg.addEventListener("dblclick", () => this.zoom(null));
  }
  // What is measured nearest to x, in words.
  read(x) {
    const points = this.panels.flatMap(panel => panel.series.filter(one => one.look === "mean"));
    const every = [...new Set(points.flatMap(one => one.x))];
    if (!every.length) return;
    const nearest = every.reduce((a, b) => Math.abs(b - x) < Math.abs(a - x) ? b : a);
    const at = this.scale.toX(nearest);
    this.cursor.setAttribute("x1", at);
    this.cursor.setAttribute("x2", at);
    this.cursor.setAttribute("visibility", "visible");
    const lines = this.panels.map(panel => panel.series.filter(one => one.look === "mean").map(one => {
      const k = one.x.indexOf(nearest), error = one.e?.[k] ? ` ± ${words(one.e[k], 2)}` : "";
      return k < 0 ? "" : `${one.short || panel.y} ${words(one.y[k])}${error}`;
    }).filter(Boolean).join(", ")).filter(Boolean);
    this.readout.textContent = `${this.spec.symbol} = ${words(nearest)} ${this.spec.unit}: ${lines.join("; ")}`;
  }
}
const plots = [...document.querySelectorAll("figure.plot")].map(figure => new Plot(figure));
for (const select of document.querySelectorAll("select.views"))
  select.addEventListener("change", () => plots.filter(plot => select.closest("section").contains(plot.figure))
    .forEach(plot => plot.show(Number(select.value))));

// Colours of one lightness around the circle (OKLCH), so that phase alone changes the hue.
const wheel = Array.from({length: 256}, (_, k) => {
  const h = (k + 0.5) / 128 * Math.PI, L = 0.76, a = 0.125 * Math.cos(h), b = 0.125 * Math.sin(h);
  const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3, m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (L - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s, -1.2684380046 * l + 2.6097574011 * m
    - 0.3413193965 * s, -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s].map(x => Math.min(Math.max(x, 0), 1));
});
const encoded = x => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

// The pictures of a sweep, with a slider over its displacements.
class Slides {
  constructor(section) {
    this.spec = JSON.parse(section.querySelector("script").textContent);
    this.motion = section.querySelector("select.motion");
    this.slider = section.querySelector("input[type=range]");
    this.caption = section.querySelector(".where");
    this.light = section.querySelector("canvas.light");
    this.field = section.querySelector("canvas.field");
    this.play = section.querySelector("button.play");
    this.motion.addEventListener("change", () => this.begin());
    this.slider.addEventListener("input", () => this.show());
    this.play.addEventListener("click", () => this.run());
    const turn = section.querySelector("canvas.turn");
    if (turn) {
      turn.width = 256;
      turn.height = 1;
      const image = turn.getContext("2d").createImageData(256, 1);
      wheel.forEach((colour, k) => image.data.set([...colour.map(encoded), 255], 4 * k));
      turn.getContext("2d").putImageData(image, 0, 0);
    }
    this.begin();
  }
  begin() {
    this.frames = this.spec.motions[this.motion.value];
    this.slider.max = this.frames.length - 1;
    this.slider.value = this.frames.findIndex(frame => frame.rest);
    this.show();
  }
  run() {
    if (this.timer) { clearInterval(this.timer); this.timer = null; this.play.textContent = "play"; return; }
    this.play.textContent = "stop";
    this.timer = setInterval(() => {
      this.slider.value = (Number(this.slider.value) + 1) % this.frames.length;
      this.show();
    }, 250);
  }
  async planes(frame) {
    if (frame.planes) return frame.planes;
    const image = new Image();
    image.src = "data:image/png;base64," + frame.png;
    await image.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [image.width, image.height];
    const context = canvas.getContext("2d", {willReadFrequently: true});
    context.drawImage(image, 0, 0);
    const grey = context.getImageData(0, 0, image.width, image.height).data.filter((_, k) => k % 4 === 0);
    const {rows, columns} = this.spec, size = rows * columns;
    frame.planes = Array.from({length: grey.length / size}, (_, k) => grey.subarray(k * size, (k + 1) * size));
    return frame.planes;
  }
  async show() {
    const frame = this.frames[this.slider.value], [light, phase, amplitude] = await this.planes(frame);
    if (frame !== this.frames[this.slider.value]) return;
    this.paint(this.light, k => Array(3).fill((light[k] / 255) ** 2 * 255));
    const bright = amplitude || light;
    if (this.field) this.paint(this.field, k => wheel[phase[k]].map(x => encoded(x * (bright[k] / 255) ** 2)));
    this.caption.textContent = frame.words;
    this.light.dataset.frame = this.slider.value;
  }
  paint(canvas, colour) {
    const {rows, columns} = this.spec;
    [canvas.width, canvas.height] = [columns, rows];
    const context = canvas.getContext("2d"), image = context.createImageData(columns, rows);
    for (let k = 0; k < rows * columns; k++) image.data.set([...colour(k), 255], 4 * k);
    context.putImageData(image, 0, 0);
  }
}
document.querySelectorAll("section .slides").forEach(one => new Slides(one));
