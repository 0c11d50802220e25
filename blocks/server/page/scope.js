/** One scope: its plot, its legend with the numbers, and how both follow what comes. */
import uPlot from "./vendor/uplot.js";
import { Curve, drawBand, drawLine, drawMarks } from "./curves.js";
import { counted, element, seconds, shown, table } from "./elements.js";

/** Colors on light and on dark, and dashes: as in figures of results. */
const COLORS = [["#b45309", "#fbbf24"], ["#1d4ed8", "#7aa2ff"], ["#0f766e", "#34d399"], ["#7e22ce", "#c4b5fd"], ["#64748b", "#cbd5e1"], ["#be123c", "#fb7185"]];
const DASHES = [[], [7, 3], [2, 2], [9, 2, 2, 2], [14, 3], [4, 2, 1, 2, 1, 2]];
const KINDS = ["ghost", "overlay", "run"]; // of curves, those above others last
const AXIS = 78; // pixels beside a plot
const SMALLEST = 1e-5; // part of a value that an axis shows at least: float32 has no finer ones
export const dark = matchMedia("(prefers-color-scheme: dark)");
const ink = () => (dark.matches ? "#e5e7eb" : "#1f2937");
const faint = () => (dark.matches ? "#64748b66" : "#94a3b880");

/** A value, as a number in the legend or on a wire. */
export function short(value) {
  if (value == null || !Number.isFinite(value)) return value == null ? "-" : "not finite";
  const size = Math.abs(value);
  return size >= 1e5 && size < 1e7 ? String(Math.round(value)) : shown(value, 5); // 123456 is not 123460
}
/** The signal that a name is an element of, "u" of "u[1]"; or the name. */
const owner = (name) => name.replace(/\[[\d,]+\]$/, "");
/** Pixels from a time to the next at the axis: far from 0 their labels are long. */
const apart = (_u, _axis, t0, t1) => Math.max(50, 52 + 7 * Math.log10(Math.max(Math.abs(t0), Math.abs(t1)) / (t1 - t0)));

export class Scope {
  /** pane: all scopes, with the times and the cursor that they share. */
  constructor(id, signals, pane) {
    Object.assign(this, { id, signals, pane, keys: "", spoken: "", lines: [], units: [""] });
    /** @type {Map<string, Curve>} "run 0", "ghost 3", "overlay lab.csv", "events 0" */
    this.curves = new Map();
    this.plot = element("div", { class: "scope-plot", tabindex: "0", role: "group", onkeydown: pane.press });
    this.caption = element("caption");
    this.line = element("div", { class: "scope-cursor", hidden: true });
    const add = element("input", { list: "scope-signals", placeholder: "Add a signal", "aria-label": "Add a signal to this scope" });
    add.onchange = () => {
      this.include(add.value.trim());
      add.value = "";
    };
    const close = element("button", { onclick: () => pane.remove(this) }, "Close");
    const legend = table(["signal", "unit", "cursor", "min", "max", "last", ""], []);
    legend.prepend(this.caption);
    [this.rows] = legend.tBodies;
    this.section = element("section", { class: "scope" }, this.plot, element("div", { class: "scope-side" }, element("div", { class: "tools" }, add, close), legend));
    new ResizeObserver(() => this.resized()).observe(this.plot);
  }

  /** The signal that has an element, and the place of this among all: "M[1,0]" of a matrix. */
  element(name) {
    const index = /\[([\d,]+)\]$/.exec(name)?.[1].split(",").map(Number) ?? [];
    const shape = this.pane.shape(owner(name));
    return [owner(name), index.reduce((k, i, axis) => k * (shape[axis] ?? 1) + i, 0)];
  }

  include(name) {
    if (!name || this.signals.includes(name)) return;
    this.signals = [...this.signals, name];
    this.pane.ask(this);
    this.arrange();
  }

  exclude({ name, kind, of }) {
    const column = kind === "overlay" ? `${of}|${name}` : name;
    if (kind === "overlay" && !this.signals.includes(column)) return this.pane.lose(of);
    this.signals = this.signals.filter((one) => one !== column && one !== owner(column));
    if (!this.signals.length) return this.pane.remove(this);
    this.curves.clear();
    this.pane.ask(this);
    return this.arrange();
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.plot;
    if (!width || !height) return;
    this.u?.setSize({ width, height });
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.pane.ask(this), 150);
  }

  take(frame) {
    const { kind, of } = frame.header;
    this.curves.set(`${kind} ${of}`, new Curve(frame));
    this.arrange();
  }

  /** Axes and legend for the lines that there are now: {curve, column, name, unit, label, kind, of, look}. */
  arrange() {
    const styles = [];
    this.lines = [...this.curves.values()].filter(({ header }) => header.kind !== "events").flatMap((curve) =>
      curve.header.signals.map((name, column) => {
        const { kind, of, units } = curve.header;
        const own = kind === "overlay" ? `${of}|${name}` : name;
        if (!styles.includes(own)) styles.push(own);
        const style = styles.indexOf(own) % COLORS.length;
        const look = { color: COLORS[style][dark.matches ? 1 : 0], dash: DASHES[style], width: 1.5, dots: kind === "overlay" };
        if (kind === "ghost") Object.assign(look, { dash: [2, 3], width: 1, alpha: 0.6 });
        const label = kind === "run" ? name : `${name}, ${kind === "ghost" ? this.pane.label(of) : of}`;
        return { curve, column, name, label, kind, of, unit: units[column], look };
      }));
    const run = this.pane.run();
    const keys = JSON.stringify([this.lines.map(({ label, unit }) => [label, unit]), this.signals, Boolean(run), dark.matches]);
    if (keys === this.keys) return;
    this.keys = keys;
    this.units = [...new Set(this.lines.map(({ unit }) => unit))];
    if (!this.units.length) this.units = [""];
    const names = this.signals.join(", ");
    this.section.setAttribute("aria-label", `Scope of ${names}`);
    this.plot.setAttribute("aria-label", `${names} over time. Arrow keys move the cursor, plus and minus zoom, 0 shows all, F follows.`);
    const row = (line, ...cells) => {
      const { color, dash, width } = line.look ?? { dash: [] };
      const path = element("svg:path", { d: "M0 3H28", stroke: color, "stroke-width": width, "stroke-dasharray": dash.join(" ") });
      const remove = element("button", { "aria-label": `Remove ${line.label}`, onclick: () => this.exclude(line) }, "×");
      const head = element("th", { scope: "row" }, color ? element("svg:svg", { "aria-hidden": "true" }, path) : "", line.label);
      return element("tr", { class: line.kind }, head, ...cells, element("td", {}, line.kind === "ghost" ? "" : remove));
    };
    this.cells = this.lines.map(() => [0, 1, 2, 3].map(() => element("td")));
    const known = new Set(this.lines.flatMap(({ name, kind }) => (kind === "run" ? [name, owner(name)] : [])));
    const missing = this.signals.filter((name) => !known.has(name) && !name.includes("|"));
    const why = run ? "not recorded: run anew" : "no run yet";
    this.rows.replaceChildren(
      ...this.lines.map((line, k) => row(line, element("td", { class: "unit" }, line.unit || "-"), ...this.cells[k])),
      ...missing.map((name) => row({ name, label: name }, element("td", { colspan: "5" }, why))));
    this.build();
    this.pane.arranged();
  }

  build() {
    const line = { stroke: faint, width: 0.5 };
    const axis = { stroke: ink, grid: line, ticks: { ...line, size: 4 }, font: "12px sans-serif", labelFont: "12px sans-serif", labelSize: 16, values: (_u, splits) => splits.map((x) => shown(x, 12)) };
    const scales = { x: { time: false, range: (_u, min, max) => [min, max] } };
    const axes = [{ ...axis, label: "time [s]", labelGap: -2, size: 24, space: apart }];
    this.units.forEach((unit, k) => {
      scales[`y${k}`] = { range: () => this.range(unit) };
      axes.push({ ...axis, scale: `y${k}`, side: k ? 1 : 3, label: unit ? `[${unit}]` : " ", size: AXIS - 16, grid: k ? { show: false } : line });
    });
    this.u?.destroy();
    this.u = new uPlot({
      width: this.plot.clientWidth || 600, height: this.plot.clientHeight || 160, scales, axes, legend: { show: false },
      // All plots are as wide as the one with the most axes: they share their times.
      padding: [8, () => 24 + AXIS * (this.pane.axes() - this.units.length), 0, 0],
      series: [{}, ...this.units.map((_unit, k) => ({ scale: `y${k}`, paths: () => null, points: { show: false } }))],
      cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
      hooks: { draw: [() => this.draw()], setSelect: [() => this.selected()], setCursor: [() => this.moved()] },
    }, [[0, 1], ...this.units.map(() => [null, null])], this.plot);
    const { over } = this.u;
    over.append(this.line);
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (event.shiftKey) this.pane.pan(Math.sign(event.deltaX || event.deltaY) * 0.1);
      else this.pane.zoom(1.2 ** Math.sign(event.deltaY), this.u.posToVal(event.offsetX, "x"));
    }, { passive: false });
    over.addEventListener("click", () => this.isDragged || this.pane.pin());
    over.addEventListener("dblclick", () => this.pane.look({}));
  }

  selected() {
    const { left, width } = this.u.select;
    this.isDragged = width > 3;
    setTimeout(() => (this.isDragged = false));
    if (!this.isDragged) return;
    this.u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.pane.look({ t0: this.u.posToVal(left, "x"), t1: this.u.posToVal(left + width, "x") });
  }

  /** The mouse has moved, and not only the times beneath it. */
  moved() {
    const { left } = this.u.cursor;
    if (left >= 0 && left !== this.was) this.pane.hover(this.u.posToVal(left, "x"));
    this.was = left;
  }

  band = ({ name, kind }) => (kind === "run" ? this.pane.band(this.element(name).join()) : undefined);

  /** What an axis shows. */
  range(unit) {
    const [t0, t1] = this.pane.shown();
    const found = this.lines.filter((line) => line.unit === unit).flatMap((line) => {
      const band = this.band(line);
      return [line.curve.range(line.column, t0, t1, 1), ...(band?.columns ?? []).map((_, k) => band.range(k, t0, t1))];
    });
    let [low, high] = [Math.min(...found.map(([least]) => least)), Math.max(...found.map(([, most]) => most))];
    const least = (SMALLEST * Math.max(Math.abs(low), Math.abs(high)) - (high - low)) / 2;
    if (least > 0 && high > low) [low, high] = [low - least, high + least];
    return low > high ? [0, 1] : uPlot.rangeNum(low, high, 0.1, true);
  }

  /** Give uPlot the times of now; it draws. */
  show([min, max]) {
    if (this.u && this.plot.clientWidth) this.u.setScale("x", { min, max });
  }

  draw() {
    const { u } = this;
    const { left, top, width, height } = u.bbox;
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(left, top, width, height);
    u.ctx.clip();
    // The first signal comes last: it stays on top.
    for (const line of this.lines.toReversed().sort((a, b) => KINDS.indexOf(a.kind) - KINDS.indexOf(b.kind))) {
      const scale = u.scales[`y${this.units.indexOf(line.unit)}`];
      const band = this.band(line);
      if (band) drawBand(u, scale, band, line.look.color);
      drawLine(u, scale, line.curve, line.column, line.look);
    }
    if (this.curves.has("events 0")) drawMarks(u, this.curves.get("events 0"), ink());
    u.ctx.restore();
    this.place();
  }

  /** The cursor's line. */
  place() {
    const t = this.pane.cursor();
    const left = t === null || !this.u ? -1 : this.u.valToPos(t, "x");
    this.line.hidden = !(left >= 0 && left <= this.u.over.clientWidth);
    if (!this.line.hidden) this.line.style.transform = `translateX(${left}px)`;
  }

  /** The numbers of the legend. values: of the run, at the cursor; others: of the curves beside it. */
  tell(values, others) {
    const [cursor, [t0, t1]] = [this.pane.cursor(), this.pane.shown()];
    const spoken = [];
    this.lines.forEach(({ curve, column, name, label, kind, of, unit }, k) => {
      const [base, place] = this.element(name);
      const own = Object.hasOwn(values, base) ? ([values[base]].flat()[place] ?? NaN) : null;
      const at = cursor === null ? null : kind === "run" ? own : others[`${kind} ${of}`]?.[column];
      const [low, high, last] = curve.range(column, t0, t1);
      [at, low > high ? null : low, low > high ? null : high, last].forEach((value, i) => (this.cells[k][i].textContent = short(value)));
      if (at != null) spoken.push(`${label} ${short(at)} ${unit}`.trim());
    });
    this.spoken = spoken.join(", ");
    const close = (4 * (t1 - t0)) / (this.u?.over.clientWidth || 600);
    const near = cursor === null ? [] : this.events(cursor - close, cursor + close);
    const fired = near.length && `${near[1][0]}: ${near[1][1]} at ${seconds(near[2], [t0, t1])}${near[0] > 1 ? ` and ${near[0] - 1} more` : ""}`;
    const [count] = this.events(t0, t1);
    this.caption.textContent = [`${seconds(t0, [t0, t1])} to ${seconds(t1, [t0, t1])}`, count && counted(count, "event"), fired].filter(Boolean).join("; ");
  }

  /** Of the events between two times: how many, what the first one is, and when. */
  events(t0, t1) {
    const curve = this.curves.get("events 0");
    const [first, end] = curve?.rows(t0, t1) ?? [0, 0];
    if (first >= end) return [];
    const [causes, counts] = curve.columns;
    return [counts[end - 1] - counts[first] + 1, curve.header.events[causes[first]], curve.t[first]];
  }
}
