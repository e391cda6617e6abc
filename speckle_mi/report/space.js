// Bodies in space, turned with the mouse: drawn in parallel projection, the farthest first.
const looks = {glass: "120,180,230", mirror: "150,150,155", opening: "70,72,76", opaque: "140,140,140",
  target: "190,170,140", detector: "40,42,46", laser: "200,30,30"};
const opacity = {glass: 0.16, mirror: 1, opening: 1, opaque: 0.45, target: 1, detector: 1, laser: 0.13};
const poses = {free: [-0.6, 0.35], side: [0, 0], above: [0, -Math.PI / 2], front: [Math.PI / 2, 0]};

class Space {
  constructor(figure) {
    this.spec = JSON.parse(figure.querySelector("script").textContent);
    this.canvas = figure.querySelector("canvas");
    this.names = figure.querySelector(".names");
    this.focus = figure.querySelector(".focus");
    this.pose = figure.querySelector(".pose");
    for (const [value, name] of [["", "everything"], ...this.spec.solids.map((one, k) => [k, one.name])])
      this.focus.add(new Option(name, value));
    this.focus.addEventListener("change", () => this.centreOn(this.focus.value));
    this.pose.addEventListener("change", () => { [this.yaw, this.pitch] = poses[this.pose.value]; this.draw(); });
    this.names.addEventListener("change", () => this.draw());
    [this.yaw, this.pitch] = poses.free;
    this.prepare();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    new MutationObserver(() => this.draw()).observe(document.documentElement, {attributes: true});
    this.centreOn("");
    this.load();
  }
  async load() {
    for (const one of this.spec.patterns) {
      const image = new Image();
      image.src = "data:image/png;base64," + one.png;
      await image.decode();
      one.image = image;
    }
    this.draw();
  }
  prepare() {
    const middle = points => [0, 1, 2].map(k => points.reduce((sum, p) => sum + p[k], 0) / points.length);
    this.items = [];
    for (const solid of this.spec.solids) {
      for (const points of solid.polygons) this.items.push({points, kind: solid.kind, at: middle(points)});
      for (const rim of solid.rims) this.pieces(rim, {kind: "rim", of: solid.kind});
    }
    for (const line of this.spec.lines) this.pieces(line.points, line);
    for (const one of this.spec.patterns) this.items.push({kind: "pattern", pattern: one,
      at: middle([one.corners[1], one.corners[2]])});
  }
  // Long lines in pieces, each drawn where it is in the depth.
  pieces(points, what) {
    for (let k = 1; k < points.length; k++) {
      const [a, b] = [points[k - 1], points[k]], count = what.kind === "rim" ? 1 : 12;
      const at = t => a.map((x, i) => x + t * (b[i] - x));
      for (let piece = 0; piece < count; piece++)
        this.items.push({...what, points: [at(piece / count), at((piece + 1) / count)], at: at((piece + 0.5) / count)});
    }
  }
  centreOn(which) {
    const chosen = which === "" ? this.spec.solids : [this.spec.solids[which]];
    const points = chosen.flatMap(one => [...one.polygons.flat(), ...one.rims.flat(), one.place]);
    if (which === "") points.push(...this.spec.lines.flatMap(line => line.points));
    const low = [0, 1, 2].map(k => points.reduce((m, p) => Math.min(m, p[k]), Infinity));
    const high = [0, 1, 2].map(k => points.reduce((m, p) => Math.max(m, p[k]), -Infinity));
    this.centre = low.map((x, k) => (x + high[k]) / 2);
    this.extent = Math.hypot(...high.map((x, k) => x - low[k])) || 1;
    this.zoom = 1;
    this.draw();
  }
  get turn() {
    const [c, s, C, S] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    return [[c, 0, s], [S * s, C, -S * c], [-C * s, S, C * c]];
  }
  draw() {
    const ratio = window.devicePixelRatio || 1, width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (!width) return;
    [this.canvas.width, this.canvas.height] = [width * ratio, height * ratio];
    const context = this.canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const [ink, soft, paper, wrong] = ["--ink", "--soft", "--card", "--warn"].map(name => style.getPropertyValue(name));
    context.scale(ratio, ratio);
    const turn = this.turn, scale = this.scale = 0.92 * this.zoom * Math.min(width, 1.6 * height) / this.extent;
    const seen = p => {
      const [x, y, z] = p.map((value, k) => value - this.centre[k]);
      const [a, b, c] = turn.map(row => row[0] * x + row[1] * y + row[2] * z);
      return [width / 2 + scale * a, height / 2 - scale * b, c];
    };
    const sorted = this.items.map(item => ({item, depth: seen(item.at)[2] + (item.kind === "pattern" ? 1e-3 : 0)
      * this.extent})).sort((a, b) => a.depth - b.depth);
    for (const {item} of sorted) this.paint(context, item, seen, {ink, wrong});
    this.arrows(context, seen, soft);
    this.problems(context, seen, wrong);
    if (this.names.checked) this.labels(context, seen, ink, paper, wrong);
    this.ruler(context, height, ink);
  }
  paint(context, item, seen, {ink, wrong}) {
    if (item.kind === "pattern") { this.pattern(context, item.pattern, seen); return; }
    const points = item.points.map(seen);
    context.beginPath();
    points.forEach(([x, y], k) => k ? context.lineTo(x, y) : context.moveTo(x, y));
    if (item.kind === "ray" || item.kind === "ended" || item.kind === "rim") {
      context.strokeStyle = item.kind === "ray" ? item.colour : item.kind === "ended" ? wrong
        : item.of === "laser" ? "rgb(200,30,30)" : ink;
      context.globalAlpha = item.kind === "rim" ? 0.6 : 1;
      context.lineWidth = item.kind === "ray" && item.chief ? 2 : 1;
      context.setLineDash(item.kind === "ended" ? [2, 3] : []);
      context.stroke();
      context.globalAlpha = 1;
      context.setLineDash([]);
      return;
    }
    context.closePath();
    const [a, b, c] = points, u = [b[0] - a[0], b[1] - a[1], (b[2] - a[2]) * this.scale];
    const v = [c[0] - a[0], c[1] - a[1], (c[2] - a[2]) * this.scale];
    const across = u[0] * v[1] - u[1] * v[0], whole = Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2],
      across) || 1;
    const shade = 0.55 + 0.45 * Math.abs(across) / whole;
    const colour = looks[item.kind].split(",").map(x => Math.round(x * shade)).join(",");
    context.fillStyle = `rgba(${colour},${opacity[item.kind]})`;
    context.fill();
    if (opacity[item.kind] < 1) return;
    context.strokeStyle = context.fillStyle;  // over the seams between neighbours
    context.lineWidth = 0.7;
    context.stroke();
  }
  pattern(context, one, seen) {
    if (!one.image) return;
    const [o, u, v] = one.corners.map(seen), ratio = window.devicePixelRatio || 1;
    context.save();
    context.setTransform((u[0] - o[0]) / one.image.width * ratio, (u[1] - o[1]) / one.image.width * ratio,
      (v[0] - o[0]) / one.image.height * ratio, (v[1] - o[1]) / one.image.height * ratio, o[0] * ratio, o[1] * ratio);
    context.drawImage(one.image, 0, 0);
    context.restore();
  }
  arrows(context, seen, soft) {
    context.strokeStyle = context.fillStyle = soft;
    context.lineWidth = 1.2;
    context.font = "italic 12px system-ui, sans-serif";
    for (const one of this.spec.arrows) {
      const [a, b] = [seen(one.from), seen(one.to)], length = Math.hypot(b[0] - a[0], b[1] - a[1]);
      if (length < 14) continue;
      const [x, y] = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      context.moveTo(b[0] - 6 * x + 3 * y, b[1] - 6 * y - 3 * x);
      context.lineTo(b[0], b[1]);
      context.lineTo(b[0] - 6 * x - 3 * y, b[1] - 6 * y + 3 * x);
      context.stroke();
      context.fillText(one.name, b[0] + 8 * x - 3, b[1] + 8 * y + 4);
    }
  }
  problems(context, seen, wrong) {
    context.strokeStyle = wrong;
    context.lineWidth = 2.5;
    for (const one of this.spec.problems) {
      const [x, y] = seen(one.place);
      context.beginPath();
      context.moveTo(x - 6, y - 6);
      context.lineTo(x + 6, y + 6);
      context.moveTo(x + 6, y - 6);
      context.lineTo(x - 6, y + 6);
      context.stroke();
    }
  }
  // Names above what they belong to; one that would lie on another goes up, with a thin line to its place.
  labels(context, seen, ink, paper, wrong) {
    const taken = [], named = [...this.spec.solids.map(one => [one.name, one.place, ink]),
      ...this.spec.problems.filter(one => one.words).map(one => [one.words, one.place, wrong])];
    const sorted = named.map(([name, place, colour]) => ({name, at: seen(place), colour}))
      .sort((a, b) => b.at[1] - a.at[1]);
    context.font = "13px system-ui, sans-serif";
    context.textAlign = "center";
    for (const {name, at: [x, y], colour} of sorted) {
      const half = context.measureText(name).width / 2 + 3;
      let top = y - 24;
      while (taken.some(one => Math.abs(one.x - x) < one.half + half && Math.abs(one.top - top) < 17)) top -= 4;
      taken.push({x, top, half});
      context.strokeStyle = colour;
      context.lineWidth = 0.6;
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x, top + 16);
      context.stroke();
      context.strokeStyle = paper;
      context.lineWidth = 4;
      context.lineJoin = "round";
      context.strokeText(name, x, top + 12);
      context.fillStyle = colour;
      context.fillText(name, x, top + 12);
    }
    context.textAlign = "start";
  }
  ruler(context, height, ink) {
    const rough = 120 / this.scale, unit = 10 ** Math.floor(Math.log10(rough));
    const length = [5, 2, 1].map(k => k * unit).find(k => k <= rough);
    context.strokeStyle = context.fillStyle = ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(14, height - 20);
    context.lineTo(14, height - 14);
    context.lineTo(14 + length * this.scale, height - 14);
    context.lineTo(14 + length * this.scale, height - 20);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.fillText(length >= 1 ? `${words(length)} mm` : `${words(1e3 * length)} µm`, 18, height - 20);
  }
  move(dx, dy) {
    const turn = this.turn;
    this.centre = this.centre.map((x, k) => x - (dx * turn[0][k] - dy * turn[1][k]) / this.scale);
    this.draw();
  }
  near(factor) { this.zoom = Math.min(Math.max(this.zoom * factor, 0.1), 1e6); this.draw(); }
  rotate(dx, dy) {
    this.yaw += dx;
    this.pitch = Math.min(Math.max(this.pitch + dy, -Math.PI / 2), Math.PI / 2);
    this.draw();
  }
  listen() {
    const held = new Map();
    this.canvas.addEventListener("pointerdown", event => {
      held.set(event.pointerId, [event.clientX, event.clientY]);
      try { this.canvas.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone already */ }
    });
    this.canvas.addEventListener("pointermove", event => {
      const last = held.get(event.pointerId), now = [event.clientX, event.clientY];
      if (!last) return;
      const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
      if (held.size === 2) {
        const other = [...held.entries()].find(([id]) => id !== event.pointerId)[1];
        const apart = point => Math.hypot(point[0] - other[0], point[1] - other[1]);
        held.set(event.pointerId, now);
        this.near(apart(now) / Math.max(apart(last), 1));
        this.move(dx / 2, dy / 2);
        return;
      }
      held.set(event.pointerId, now);
      if (event.shiftKey || event.buttons === 4) this.move(dx, dy);
      else this.rotate(dx * 0.008, dy * 0.008);
    });
    for (const end of ["pointerup", "pointercancel"])
      this.canvas.addEventListener(end, event => held.delete(event.pointerId));
    this.canvas.addEventListener("wheel", event => {
      event.preventDefault();
      const box = this.canvas.getBoundingClientRect(), factor = Math.exp(-event.deltaY * 0.0015);
      const [x, y] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
      this.move(x * (1 - factor), y * (1 - factor));
      this.near(factor);
    }, {passive: false});
    this.canvas.addEventListener("dblclick", event => {
      const box = this.canvas.getBoundingClientRect();
      this.move(box.width / 2 - (event.clientX - box.left), box.height / 2 - (event.clientY - box.top));
    });
    this.canvas.addEventListener("keydown", event => {
      const step = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}[event.key];
      if (step) { event.preventDefault(); this.rotate(...step); }
      if (event.key === "+" || event.key === "-") this.near(event.key === "+" ? 1.2 : 1 / 1.2);
    });
  }
}
document.querySelectorAll("figure.space").forEach(figure => { figure.space = new Space(figure); });
