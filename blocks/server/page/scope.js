/** One scope: its plot, its legend with the numbers, and how both follow what comes. */
import uPlot from "./vendor/uplot.js";
import { Curve, bandDrawn, bandRange, lineDrawn, marksDrawn } from "./curves.js";
import { element } from "./elements.js";

/** Colors on light and on dark, and dashes: as in figures of results. */
const COLORS = [["#b45309", "#fbbf24"], ["#1d4ed8", "#7aa2ff"], ["#0f766e", "#34d399"], ["#7e22ce", "#c4b5fd"], ["#64748b", "#cbd5e1"], ["#be123c", "#fb7185"]];
const DASHES = [[], [7, 3], [2, 2], [9, 2, 2, 2], [14, 3], [4, 2, 1, 2, 1, 2]];
const AXIS = 64; // pixels beside a plot
const SMALLEST = 4e-6; // part of a value that an axis shows at least: float32 has no finer ones
export const dark = matchMedia("(prefers-color-scheme: dark)");
const ink = () => (dark.matches ? "#e5e7eb" : "#1f2937");
const faint = () => (dark.matches ? "#64748b66" : "#94a3b880");

export function short(value) {
  if (value == null) return "-";
  if (!Number.isFinite(value)) return "not finite";
  return value !== 0 && Math.abs(value) < 1e-4 ? value.toExponential(3) : String(+value.toPrecision(5));
}
export const seconds = (t) => `${+t.toPrecision(8)} s`;
/** The signal and the number of the element that a name means: "u[1]" of a vector. */
const parts = (name) => [name.replace(/\[[\d,]+\]$/, ""), Number(/\[(\d+)\]$/.exec(name)?.[1] ?? 0)];
/** Labels of an axis: as many decimals as their distance has. */
const ticks = (_u, splits, _axis, _space, step) => {
  const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  const isOdd = digits > 9 || Math.abs(splits.at(-1)) >= 1e7;
  return splits.map((x) => (x === null ? "" : isOdd ? x.toExponential(3) : x.toFixed(digits).replace("-", "−")));
};

export class Scope {
  /** host: shown() the span of time, run(), unit(name), label(run), axes() of the widest scope, band(), and what is to be done. */
  constructor(id, signals, host) {
    Object.assign(this, { id, signals, host, keys: "", spoken: "", lines: [], units: [""], values: {} });
    /** @type {Map<string, Curve>} "run", "ghost 3", "overlay lab.csv", "events" */
    this.curves = new Map();
    this.plot = element("div", { class: "scope-plot", tabindex: "0", role: "group", onkeydown: host.keys });
    this.caption = element("caption");
    this.rows = element("tbody");
    this.line = element("div", { class: "scope-cursor", hidden: true });
    const heads = ["signal", "unit", "cursor", "min", "max", "last", ""].map((head) => element("th", { scope: "col" }, head));
    const add = element("input", { list: "scope-signals", placeholder: "Add a signal", "aria-label": "Add a signal to this scope" });
    add.onchange = () => {
      this.include(add.value.trim());
      add.value = "";
    };
    const close = element("button", { onclick: () => host.remove(this) }, "Close");
    const legend = element("table", {}, this.caption, element("thead", {}, element("tr", {}, ...heads)), this.rows);
    this.section = element("section", { class: "scope" }, this.plot, element("div", { class: "scope-side" }, element("div", { class: "tools" }, add, close), legend));
    new ResizeObserver(() => this.resized()).observe(this.plot);
  }

  include(name) {
    if (!name || this.signals.includes(name)) return;
    this.signals = [...this.signals, name];
    this.host.ask(this);
  }

  exclude({ name, curve, kind }) {
    const column = kind === "overlay" ? `${curve.header.overlay}|${name}` : name;
    if (kind === "overlay" && !this.signals.includes(column)) return this.host.lose(curve.header.overlay);
    this.signals = this.signals.filter((one) => one !== column && one !== parts(column)[0]);
    this.keys = "";
    if (!this.signals.length) return this.host.remove(this);
    this.curves.clear();
    return this.host.ask(this);
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.plot;
    if (!width || !height) return;
    this.u?.setSize({ width, height });
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.host.ask(this), 150);
  }

  take(frame, since) {
    const { ghost, overlay, kind, events } = frame.header;
    const key = events ? "events" : ghost ? `ghost ${ghost}` : overlay ? `overlay ${overlay}` : "run";
    if (!this.curves.has(key)) this.curves.set(key, new Curve());
    this.curves.get(key).take(frame, since);
    if (kind === "replace") this.arrange();
  }

  /** Axes and legend for the lines that there are now: {curve, column, name, unit, label, kind, style}. */
  arrange() {
    const styles = new Map();
    this.lines = [...this.curves].filter(([key]) => key !== "events").flatMap(([key, curve]) => {
      const { signals, units, ghost, overlay } = curve.header;
      return signals.map((name, column) => {
        const own = overlay ? `${key} ${name}` : name;
        if (!styles.has(own)) styles.set(own, styles.size);
        const label = ghost ? `${name}, ${this.host.label(ghost)}` : overlay ? `${name}, ${overlay}` : name;
        const kind = ghost ? "ghost" : overlay ? "overlay" : "";
        return { curve, column, name, label, kind, unit: units?.[column] ?? this.host.unit(parts(name)[0]), style: styles.get(own) };
      });
    });
    const run = this.host.run();
    const keys = JSON.stringify([this.lines.map(({ label, unit }) => [label, unit]), this.signals, Boolean(run)]);
    if (keys === this.keys) return;
    this.keys = keys;
    this.units = [...new Set(this.lines.map(({ unit }) => unit))];
    if (!this.units.length) this.units = [""];
    const names = this.signals.join(", ");
    this.section.setAttribute("aria-label", `Scope of ${names}`);
    this.plot.setAttribute("aria-label", `${names} over time. Arrow keys move the cursor, plus and minus zoom, 0 shows all, F follows.`);
    const button = (line) => element("button", { "aria-label": `Remove ${line.label}`, onclick: () => this.exclude(line) }, "×");
    this.cells = this.lines.map((line) => {
      const swatch = element("canvas", { width: "56", height: "12", "aria-hidden": "true" });
      const numbers = [0, 1, 2, 3].map(() => element("td"));
      const row = element("tr", { class: line.kind }, element("th", { scope: "row" }, swatch, line.label), element("td", { class: "unit" }, line.unit || "-"), ...numbers, element("td", {}, line.kind === "ghost" ? "" : button(line)));
      return { line, swatch, numbers, row };
    });
    const known = new Set(this.lines.filter(({ kind }) => !kind).flatMap(({ name }) => [name, parts(name)[0]]));
    const missing = this.signals.filter((name) => !known.has(name) && !name.includes("|")).map((name) =>
      element("tr", {}, element("th", { scope: "row" }, name), element("td", { colspan: "5" }, run ? "not recorded: run anew" : "no run yet"), element("td", {}, button({ name, label: name }))));
    this.rows.replaceChildren(...this.cells.map(({ row }) => row), ...missing);
    this.build();
    this.swatches();
    this.host.arranged();
  }

  build() {
    const line = { stroke: faint, width: 0.5 };
    const axis = { stroke: ink, grid: line, ticks: { ...line, size: 4 }, font: "12px sans-serif", labelFont: "12px sans-serif", labelSize: 16, values: ticks };
    const scales = { x: { time: false, range: (_u, min, max) => [min, max] } };
    const axes = [{ ...axis, label: "time [s]", labelGap: -2, size: 24 }];
    this.units.forEach((unit, k) => {
      scales[`y${k}`] = { range: (_u, min, max) => [min ?? 0, max ?? 1] };
      axes.push({ ...axis, scale: `y${k}`, side: k ? 1 : 3, label: unit ? `[${unit}]` : " ", size: AXIS - 16, grid: k ? { show: false } : line });
    });
    this.u?.destroy();
    this.u = new uPlot({
      width: this.plot.clientWidth || 600, height: this.plot.clientHeight || 160, scales, axes, legend: { show: false },
      // All plots are as wide as the one with the most axes: they share their times.
      padding: [8, () => 16 + AXIS * (this.host.axes() - this.units.length), 0, 0],
      series: [{}, ...this.units.map((_unit, k) => ({ scale: `y${k}`, paths: () => null, points: { show: false } }))],
      cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
      hooks: { draw: [() => this.draw()], setSelect: [() => this.selected()], setCursor: [() => this.moved()] },
    }, [[0, 1], ...this.units.map(() => [null, null])], this.plot);
    const { over } = this.u;
    over.append(this.line);
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (event.shiftKey) this.host.pan(Math.sign(event.deltaX || event.deltaY) * 0.1);
      else this.host.zoom(1.2 ** Math.sign(event.deltaY), this.u.posToVal(event.offsetX, "x"));
    }, { passive: false });
    over.addEventListener("click", () => this.isDragged || this.host.pin());
    over.addEventListener("dblclick", () => this.host.all());
  }

  selected() {
    const { left, width } = this.u.select;
    this.isDragged = width > 3;
    setTimeout(() => (this.isDragged = false));
    if (!this.isDragged) return;
    this.u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.host.look({ t0: this.u.posToVal(left, "x"), t1: this.u.posToVal(left + width, "x") });
  }

  moved() {
    const { left } = this.u.cursor;
    if (left === undefined || left < 0 || left === this.was) return;
    this.was = left;
    this.host.hover(this.u.posToVal(left, "x"));
  }

  /** Give uPlot the ranges of now; it draws. */
  show([t0, t1]) {
    if (!this.u || !this.plot.clientWidth) return;
    this.units.forEach((unit, k) => {
      let [low, high] = [Infinity, -Infinity];
      for (const line of this.lines) {
        if (line.unit !== unit) continue;
        const found = [line.curve.range(line.column, t0, t1), bandRange(this.host.band(), ...parts(line.name), t0, t1)];
        [low, high] = [Math.min(low, ...found.map((one) => one[0])), Math.max(high, ...found.map((one) => one[1]))];
      }
      const least = (SMALLEST * Math.max(Math.abs(low), Math.abs(high)) - (high - low)) / 2;
      if (least > 0 && high > low) [low, high] = [low - least, high + least];
      const [min, max] = low > high ? [0, 1] : uPlot.rangeNum(low, high, 0.1, true);
      this.u.setScale(`y${k}`, { min, max });
    });
    this.u.setScale("x", { min: t0, max: t1 });
  }

  draw() {
    const { u } = this;
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    const band = this.host.band();
    const order = ["ghost", "overlay", ""];
    for (const line of this.lines.toSorted((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind))) {
      const scale = u.scales[`y${this.units.indexOf(line.unit)}`];
      if (band && !line.kind) bandDrawn(u, scale, band, ...parts(line.name), this.look(line).color);
      lineDrawn(u, scale, line.curve, line.column, this.look(line));
    }
    if (this.curves.has("events")) marksDrawn(u, this.curves.get("events"), ink());
    u.ctx.restore();
    this.place();
  }

  look({ kind, style }) {
    const color = COLORS[style % COLORS.length][dark.matches ? 1 : 0];
    if (kind === "ghost") return { color, dash: [2, 3], width: 1, alpha: 0.6, dots: false };
    return { color, dash: DASHES[style % DASHES.length], width: 1.5, alpha: 1, dots: kind === "overlay" };
  }

  swatches() {
    for (const { line, swatch } of this.cells ?? []) {
      const context = swatch.getContext("2d");
      const { color, dash, width, alpha } = this.look(line);
      context.reset();
      Object.assign(context, { strokeStyle: color, lineWidth: 2 * width, globalAlpha: alpha });
      context.setLineDash(dash.map((length) => 2 * length));
      context.stroke(new Path2D("M0 6H56"));
    }
  }

  /** The cursor's line. */
  place() {
    const t = this.host.cursor();
    const left = t === null || !this.u ? -1 : this.u.valToPos(t, "x");
    this.line.hidden = !(left >= 0 && left <= this.u.over.clientWidth);
    if (!this.line.hidden) this.line.style.transform = `translateX(${left}px)`;
  }

  /** The numbers of the legend. values: of the run, at the cursor. */
  tell(values = this.values) {
    this.values = values;
    const [cursor, [t0, t1]] = [this.host.cursor(), this.host.shown()];
    const spoken = [];
    for (const { line, numbers } of this.cells ?? []) {
      const [name, k] = parts(line.name);
      const own = line.name in values ? values[line.name] : [values[name] ?? null].flat()[k];
      const at = cursor === null ? null : line.kind ? line.curve.at(line.column, cursor) : own;
      const [low, high, last] = line.curve.range(line.column, t0, t1, true);
      [at, low > high ? null : low, low > high ? null : high, last].forEach((value, i) => (numbers[i].textContent = short(value)));
      if (at != null) spoken.push(`${line.label} ${short(at)} ${line.unit}`.trim());
    }
    this.spoken = spoken.join(", ");
    const events = this.curves.get("events");
    const count = events?.total(t0, t1) ?? 0;
    const near = events && cursor !== null ? events.near(cursor, (4 * (t1 - t0)) / (this.u?.over.clientWidth || 600)) : "";
    this.caption.textContent = [`${seconds(t0)} to ${seconds(t1)}`, count && `${count} event${count > 1 ? "s" : ""}`, near].filter(Boolean).join("; ");
  }
}
