/** Scopes: signals over a shared time axis, with a cursor, ghosts of earlier runs, measured files, events. */
import uPlot from "./vendor/uplot.js";
import { Curve, drawn, near } from "./curves.js";

/** Colors on light and on dark, and dashes: as in figures of results. */
const COLORS = [
  ["#b45309", "#fbbf24"], ["#1d4ed8", "#7aa2ff"], ["#0f766e", "#34d399"], ["#7e22ce", "#c4b5fd"],
  ["#64748b", "#cbd5e1"], ["#be123c", "#fb7185"],
];
const DASHES = [[], [6, 3], [2, 2], [8, 2, 2, 2], [12, 3], [4, 2, 1, 2, 1, 2]];
const TURN = 33; // ms between two frames that are asked for
const dark = matchMedia("(prefers-color-scheme: dark)");
const ink = () => (dark.matches ? "#e5e7eb" : "#1f2937");
const faint = () => (dark.matches ? "#37415180" : "#94a3b880");
const color = (k) => COLORS[k % COLORS.length][dark.matches ? 1 : 0];
const short = (value) => (value == null ? "-" : Number.isFinite(value) ? String(+value.toPrecision(5)) : "not finite");
const seconds = (t) => `${+t.toPrecision(8)} s`;
/** The signal and the number of the element that a name means: "u[1]" of a vector. */
const parts = (name) => [name.replace(/\[[\d,]+\]$/, ""), Number(/\[(\d+)\]$/.exec(name)?.[1] ?? 0)];

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made[name] = value;
    else if (value !== null && value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** @param {any} app */
export function start(app) {
  const place = document.getElementById("scopes");
  /** @type {Map<string, Scope>} */
  const scopes = new Map();
  const files = new Map(); // measured files: name -> {columns, stop}
  let runs = []; // earlier ones, as the server tells them
  let band = null; // of a sweep, as the server answers it
  let window_ = {}; // {}: all; {span}: the last; {t0, t1}
  let cursor = null;
  let isPinned = false;
  let isAsked = false; // values at the cursor
  let number = 0;
  let acknowledged = 0;
  const ask = (name, fields) => app.connection.ask(name, fields);
  const quietly = (promise) => promise.catch(() => null);
  const told = (error) => (bar.note.textContent = error.message) && app.announce(error.message);

  // --- the time that is shown ------------------------------------------------------------------------------------

  /** The whole of what there is, in s. */
  function whole() {
    const run = app.state.run ?? {};
    const settings = app.state.document?.settings ?? {};
    const begin = run.start ?? settings.start ?? 0;
    const last = [...scopes.values()].flatMap((scope) => [...scope.curves.values()].map((curve) => curve.last));
    const end = run.id ? (run.stop ?? null) : (settings.stop ?? null);
    return [begin, Math.max(begin + 1e-9, end ?? -Infinity, ...last, end === null && !last.length ? begin + 1 : -Infinity)];
  }

  function shown() {
    if (window_.t1 !== undefined) return [window_.t0, window_.t1];
    const [begin, end] = whole();
    if (!window_.span) return [begin, end];
    const now = app.state.run?.id ? app.state.run.t : begin;
    const last = Math.max(now, ...[...scopes.values()].map((scope) => scope.curves.get("run")?.last ?? -Infinity));
    return [Math.max(begin, last - window_.span), Math.max(last, begin + window_.span)];
  }

  let later = 0;
  function look(next, asks = true) {
    window_ = next;
    bar.follow.setAttribute("aria-pressed", String(window_.span !== undefined));
    bar.all.setAttribute("aria-pressed", String(window_.span === undefined && window_.t1 === undefined));
    draw();
    clearTimeout(later);
    if (asks) later = setTimeout(() => scopes.forEach(request), 60);
  }

  /** Zoom about a time: factor < 1 shows less. */
  function zoom(factor, about = cursor) {
    const [t0, t1] = shown();
    const at = about !== null && about >= t0 && about <= t1 ? about : (t0 + t1) / 2;
    if (factor < 1 && (t1 - t0) * factor < 1e-12 * Math.max(Math.abs(t0), Math.abs(t1), 1e-6)) return;
    look({ t0: at - (at - t0) * factor, t1: at + (t1 - at) * factor });
  }

  function pan(part) {
    const [t0, t1] = shown();
    look({ t0: t0 + part * (t1 - t0), t1: t1 + part * (t1 - t0) });
  }

  const request = (scope) =>
    ask("scope", { scope: scope.id, signals: scope.signals, width: Math.max(16, scope.plot.clientWidth), ...window_ }).catch(told);

  // --- the cursor ------------------------------------------------------------------------------------------------

  function point(t, speaks = false) {
    cursor = t;
    isPinned &&= t !== null;
    app.emit("cursor", t);
    bar.at.textContent = t === null ? "" : `t = ${seconds(t)}${isPinned ? ", pinned" : ""}`;
    scopes.forEach((scope) => scope.place(cursor));
    fetchValues(speaks);
  }

  /** One question at a time; the last one counts. */
  async function fetchValues(speaks = false) {
    if (isAsked) return;
    isAsked = true;
    let t = cursor;
    const at = () => (t !== null ? t : app.state.run?.id ? app.state.run.t : null);
    let answer = at() === null ? null : await quietly(ask("values", { t: at() }));
    isAsked = false;
    if (t !== cursor) return fetchValues(speaks);
    const values = answer?.values ?? {};
    scopes.forEach((scope) => scope.tell(cursor === null ? null : values));
    onWires(bar.wires.checked ? values : {});
    if (speaks && cursor !== null) app.announce(`${seconds(cursor)}. ${[...scopes.values()].map((scope) => scope.spoken).join(". ")}`);
  }

  /** Values beside the beginnings of wires of the drawing. */
  function onWires(values) {
    const drawing = document.getElementById("drawing");
    drawing.querySelectorAll(".wire-value").forEach((label) => label.remove());
    const level = app.state.level ? `${app.state.level}.` : "";
    const seen = new Set();
    for (const wire of drawing.querySelectorAll("g[data-net]")) {
      const value = values[level + wire.dataset.net];
      const line = wire.querySelector("path.run");
      if (value === undefined || !line || seen.has(wire.dataset.net)) continue;
      seen.add(wire.dataset.net);
      const label = document.createElementNS("http://www.w3.org/2000/svg", "text");
      const { x, y } = line.getPointAtLength(4);
      label.setAttribute("class", "wire-value");
      label.setAttribute("x", String(x));
      label.setAttribute("y", String(y - 4));
      const some = [value].flat();
      label.textContent = some.slice(0, 3).map((one) => short(one ?? NaN)).join(", ") + (some.length > 3 ? ", ..." : "");
      wire.parentNode.append(label);
    }
  }

  // --- a scope ---------------------------------------------------------------------------------------------------

  class Scope {
    constructor(signals) {
      this.id = String((number += 1));
      this.signals = signals;
      /** @type {Map<string, Curve>} of the run, "ghost 3", "overlay lab.csv", "events" */
      this.curves = new Map();
      this.keys = "";
      this.spoken = "";
      this.plot = element("div", { class: "scope-plot", tabindex: "0", role: "group", onkeydown: (event) => keys(event) });
      this.rows = element("tbody");
      this.caption = element("caption");
      const heads = ["signal", "unit", "at cursor", "min", "max", "last", ""].map((head) => element("th", { scope: "col" }, head));
      this.add = element("input", { list: "scope-signals", placeholder: "Add a signal", "aria-label": "Add a signal to this scope" });
      this.add.onchange = () => this.include(this.add.value.trim());
      const close = element("button", { type: "button", onclick: () => remove(this) }, "Close");
      const side = element("div", { class: "scope-side" },
        element("div", { class: "scope-tools" }, this.add, close),
        element("table", { class: "scope-legend" }, this.caption, element("thead", {}, element("tr", {}, ...heads)), this.rows));
      this.section = element("section", { class: "scope" }, this.plot, side);
      this.line = element("div", { class: "scope-cursor", hidden: true });
      new ResizeObserver(() => this.resized()).observe(this.plot);
    }

    include(name) {
      if (!name || this.signals.includes(name)) return;
      this.signals = [...this.signals, name];
      this.add.value = "";
      request(this);
    }

    resized() {
      const { clientWidth: width, clientHeight: height } = this.plot;
      if (!width || !height) return;
      this.u?.setSize({ width, height });
      clearTimeout(this.timer);
      this.timer = setTimeout(() => request(this), 150);
    }

    /** All lines, in the order of the legend: {curve, column, name, unit, kind, label, style}. */
    lines() {
      const found = [];
      const styles = new Map();
      for (const [key, curve] of this.curves) {
        if (key === "events") continue;
        const { signals, units, ghost, overlay } = curve.header;
        signals.forEach((name, column) => {
          const unit = units?.[column] ?? app.state.document?.signals.find((one) => one.name === parts(name)[0])?.unit ?? "";
          if (!styles.has(overlay ? key + name : name)) styles.set(overlay ? key + name : name, styles.size);
          const style = styles.get(overlay ? key + name : name);
          const label = ghost ? `${name} (${runs.find((run) => run.id === ghost)?.label ?? `run ${ghost}`})` : overlay ? `${overlay}: ${name}` : name;
          found.push({ curve, column, name, unit, label, style, kind: ghost ? "ghost" : overlay ? "overlay" : "" });
        });
      }
      return found;
    }

    take(frame) {
      const { ghost, overlay, kind, events } = frame.header;
      const key = events ? "events" : ghost ? `ghost ${ghost}` : overlay ? `overlay ${overlay}` : "run";
      if (!this.curves.has(key)) this.curves.set(key, new Curve());
      this.curves.get(key).take(frame, window_.span ? shown()[0] - window_.span : -Infinity);
      if (kind === "replace") this.arrange();
    }

    /** Axes and legend for the lines that there are now. */
    arrange() {
      const lines = this.lines();
      const keys = JSON.stringify([lines.map(({ label, unit }) => [label, unit]), this.signals]);
      if (keys === this.keys) return;
      this.keys = keys;
      this.units = [...new Set(lines.map(({ unit }) => unit))];
      if (!this.units.length) this.units = [""];
      this.build();
      const name = lines.filter(({ kind }) => !kind).map(({ name }) => name).join(", ") || this.signals.join(", ");
      this.section.setAttribute("aria-label", `Scope of ${name}`);
      this.plot.setAttribute("aria-label", `${name} over time. Arrow keys move the cursor, + and - zoom, 0 shows all, F follows.`);
      this.cells = lines.map((line) => {
        const swatch = element("canvas", { width: "44", height: "16", "aria-hidden": "true" });
        const own = !line.kind || line.kind === "overlay" ? element("button", { type: "button", "aria-label": `Remove ${line.label}`, onclick: () => this.exclude(line) }, "×") : "";
        const numbers = [0, 1, 2, 3].map(() => element("td"));
        this.rows.append(element("tr", { class: line.kind }, element("th", { scope: "row" }, swatch, line.label), element("td", {}, line.unit || "-"), ...numbers, element("td", {}, own)));
        return { line, swatch, numbers };
      });
      this.rows.replaceChildren(...[...this.rows.children].slice(-lines.length || this.rows.children.length));
      const known = new Set(lines.filter(({ kind }) => !kind).flatMap(({ name }) => [name, parts(name)[0]]));
      for (const signal of this.signals.filter((one) => !known.has(one) && !one.includes("|"))) {
        const remove_ = element("button", { type: "button", "aria-label": `Remove ${signal}`, onclick: () => this.exclude({ name: signal }) }, "×");
        const why = app.state.run?.id ? "not recorded in this run" : "no run yet";
        this.rows.append(element("tr", {}, element("th", { scope: "row" }, signal), element("td", { colspan: "5" }, why), element("td", {}, remove_)));
      }
      this.swatches();
    }

    exclude({ name, kind, curve }) {
      const gone = kind === "overlay" ? `${curve.header.overlay}|${name}` : name;
      if (kind === "overlay" && !this.signals.includes(gone)) return quietly(ask("unoverlay", { name: curve.header.overlay })).then(() => lose(curve.header.overlay));
      this.signals = this.signals.filter((one) => one !== gone && one !== parts(gone)[0]);
      this.curves.clear();
      if (this.signals.length) return request(this);
      remove(this);
    }

    build() {
      const axis = { stroke: ink, grid: { stroke: faint, width: 0.5 }, ticks: { stroke: faint, width: 0.5, size: 4 }, font: "12px sans-serif", labelFont: "12px sans-serif", labelGap: 0 };
      const scales = { x: { time: false, range: (_u, min, max) => [min, max] } };
      const axes = [{ ...axis, label: "time [s]", labelSize: 16, size: 26 }];
      this.units.forEach((unit, k) => {
        scales[`y${k}`] = { range: (_u, min, max) => [min ?? 0, max ?? 1] };
        axes.push({ ...axis, scale: `y${k}`, side: k ? 1 : 3, label: unit ? `[${unit}]` : undefined, labelSize: 16, size: 56, grid: k ? { show: false } : axis.grid });
      });
      const options = {
        width: this.plot.clientWidth || 600, height: this.plot.clientHeight || 160, scales, axes, legend: { show: false },
        series: [{}, ...this.units.map((_unit, k) => ({ scale: `y${k}`, paths: () => null, points: { show: false } }))],
        cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
        hooks: { draw: [() => this.draw()], setSelect: [(u) => this.selected(u)], setCursor: [(u) => this.moved(u)] },
      };
      this.u?.destroy();
      this.u = new uPlot(options, [[0, 1], ...this.units.map(() => [null, null])], this.plot);
      this.u.over.append(this.line);
      this.u.over.addEventListener("wheel", (event) => {
        event.preventDefault();
        if (event.shiftKey) return pan(Math.sign(event.deltaX || event.deltaY) * 0.1);
        zoom(1.2 ** Math.sign(event.deltaY), this.u.posToVal(event.offsetX, "x"));
      }, { passive: false });
      this.u.over.addEventListener("click", () => {
        if (cursor === null || this.isDragged) return;
        isPinned = !isPinned;
        point(cursor);
      });
      this.u.over.addEventListener("dblclick", () => look({}));
    }

    selected(u) {
      const { left, width } = u.select;
      this.isDragged = width > 3;
      setTimeout(() => (this.isDragged = false));
      if (!this.isDragged) return;
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      look({ t0: u.posToVal(left, "x"), t1: u.posToVal(left + width, "x") });
    }

    moved(u) {
      if (isPinned || u.cursor.left === undefined || u.cursor.left < 0 || u.cursor.left === this.was) return;
      this.was = u.cursor.left;
      point(u.posToVal(u.cursor.left, "x"));
    }

    /** Give uPlot the ranges of now; it draws. */
    show([t0, t1]) {
      if (!this.u || !this.plot.clientWidth) return;
      this.units.forEach((unit, k) => {
        let [low, high] = [Infinity, -Infinity];
        for (const { curve, column, unit: own } of this.lines()) {
          if (own !== unit) continue;
          const found = curve.range(column, t0, t1);
          [low, high] = [Math.min(low, found[0]), Math.max(high, found[1])];
        }
        const [min, max] = low > high ? [0, 1] : uPlot.rangeNum(low, high, 0.1, true);
        this.u.setScale(`y${k}`, { min, max });
      });
      this.u.setScale("x", { min: t0, max: t1 });
      this.place(cursor);
    }

    draw() {
      const { u } = this;
      u.ctx.save();
      u.ctx.beginPath();
      u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      u.ctx.clip();
      const lines = this.lines();
      const rank = { ghost: 0, overlay: 1, "": 2 };
      for (const line of [...lines].sort((a, b) => rank[a.kind] - rank[b.kind])) {
        const look_ = this.look(line);
        const scale = u.scales[`y${this.units.indexOf(line.unit)}`];
        if (band && !line.kind) drawn.band(u, scale, band, ...parts(line.name), look_.color);
        drawn.line(u, scale, line.curve, line.column, look_);
      }
      const events = this.curves.get("events");
      if (events) drawn.marks(u, events, ink());
      u.ctx.restore();
    }

    look({ kind, style }) {
      if (kind === "ghost") return { color: color(style), dash: [2, 3], width: 1, alpha: 0.55 };
      return { color: color(style), dash: DASHES[style % DASHES.length], width: 1.5, alpha: 1, dots: kind === "overlay" };
    }

    swatches() {
      for (const { line, swatch } of this.cells ?? []) {
        const context = swatch.getContext("2d");
        const { color: stroke, dash, width, alpha } = this.look(line);
        context.clearRect(0, 0, 44, 16);
        Object.assign(context, { strokeStyle: stroke, lineWidth: 2 * width, globalAlpha: alpha });
        context.setLineDash(dash.map((length) => 2 * length));
        context.beginPath();
        context.moveTo(0, 8);
        context.lineTo(44, 8);
        context.stroke();
      }
    }

    place(t) {
      const left = t === null || !this.u ? -1 : this.u.valToPos(t, "x");
      this.line.hidden = !(left >= 0 && left <= this.u.over.clientWidth);
      if (!this.line.hidden) this.line.style.transform = `translateX(${left}px)`;
    }

    /** The numbers of the legend. values: of the run at the cursor; null without a cursor. */
    tell(values = this.values) {
      this.values = values;
      const [t0, t1] = shown();
      const spoken = [];
      for (const { line, numbers } of this.cells ?? []) {
        const [name, k] = parts(line.name);
        let at = null;
        if (values && !line.kind) at = line.name in values ? values[line.name] : [values[name] ?? null].flat()[k];
        else if (values) at = near(line.curve, line.column, cursor);
        const [low, high, last] = line.curve.range(line.column, t0, t1, true);
        [at, low > high ? null : low, low > high ? null : high, last].forEach((value, i) => (numbers[i].textContent = short(value)));
        if (at !== null && at !== undefined) spoken.push(`${line.label} ${short(at)} ${line.unit}`.trim());
      }
      this.spoken = spoken.join(", ");
      const events = this.curves.get("events");
      const count = events ? events.total(t0, t1) : 0;
      const mark = events && cursor !== null ? events.near(cursor, (t1 - t0) / (this.u?.over.clientWidth || 600)) : "";
      this.caption.textContent = `${seconds(t0)} to ${seconds(t1)}${count ? `, ${count} event${count > 1 ? "s" : ""}` : ""}${mark ? `; at the cursor: ${mark}` : ""}`;
    }
  }

  function remove(scope) {
    quietly(ask("unscope", { scope: scope.id }));
    scopes.delete(scope.id);
    scope.u?.destroy();
    scope.section.remove();
    bar.empty.hidden = scopes.size > 0;
    [...scopes.values()].at(-1)?.plot.focus();
  }

  /** Open a scope of some signals, or go to the one that has them. add: to the newest scope. */
  app.openScope = (signals, { add = false } = {}) => {
    const newest = [...scopes.values()].at(-1);
    if (add && newest) return signals.forEach((name) => newest.include(name));
    const found = [...scopes.values()].find((scope) => signals.every((name) => scope.signals.includes(name)));
    if (found) {
      found.section.scrollIntoView({ block: "nearest" });
      return found.plot.focus();
    }
    const scope = new Scope([...signals]);
    scopes.set(scope.id, scope);
    list.append(scope.section);
    bar.empty.hidden = true;
    scope.arrange();
    scope.section.scrollIntoView({ block: "nearest" });
    app.announce(`A scope of ${signals.join(", ")} is open.`);
    return request(scope);
  };
  /** Show the band of a sweep over the scopes, as the server answers "band"; null takes it away. */
  app.showBand = (answer) => {
    band = answer;
    draw();
  };

  function keys(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const [t0, t1] = shown();
    const step = ((t1 - t0) / 500) * (event.shiftKey ? 20 : 1);
    const at = cursor === null ? (t0 + t1) / 2 : cursor;
    const go = (t) => {
      isPinned = true;
      point(Math.min(Math.max(t, t0), t1), true);
    };
    const actions = {
      ArrowLeft: () => go(at - step), ArrowRight: () => go(at + step), Home: () => go(t0), End: () => go(t1),
      "+": () => zoom(0.5), "-": () => zoom(2), 0: () => look({}), PageUp: () => pan(-0.5), PageDown: () => pan(0.5),
      f: () => bar.follow.click(), Escape: () => point(null),
    };
    const act = actions[event.key === "=" ? "+" : event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    act();
    event.preventDefault();
  }

  // --- drawing, as often as there is something new ---------------------------------------------------------------

  let isDue = false;
  let mustAnswer = false;
  let toldAt = 0;
  function draw() {
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      const span = shown();
      scopes.forEach((scope) => scope.show(span));
      if (performance.now() - toldAt > 150) tellAll();
      else setTimeout(() => performance.now() - toldAt > 150 && tellAll(), 160);
      if (!mustAnswer) return;
      mustAnswer = false;
      const wait = Math.max(0, TURN - (performance.now() - acknowledged));
      setTimeout(() => {
        acknowledged = performance.now();
        quietly(ask("drawn"));
      }, wait);
    });
  }
  function tellAll() {
    toldAt = performance.now();
    scopes.forEach((scope) => scope.tell());
  }

  app.connection.onFrame((frame) => {
    mustAnswer = true;
    scopes.get(frame.header.scope)?.take(frame);
    draw();
  });

  // --- the bar ---------------------------------------------------------------------------------------------------

  const bar = makeBar();
  const list = element("div", { class: "scope-list" });
  place.append(bar.section, bar.empty, list);

  function makeBar() {
    const button = (text, act, attributes = {}) => element("button", { type: "button", onclick: act, ...attributes }, text);
    const signal = element("input", { list: "scope-signals", placeholder: "Signal", "aria-label": "Signal for a new scope" });
    const open = () => signal.value.trim() && app.openScope(signal.value.trim().split(/[\s;]+/)) && (signal.value = "");
    signal.onkeydown = (event) => void (event.key === "Enter" && open());
    const span = element("input", { type: "number", min: "0", step: "any", value: "10", class: "narrow", "aria-label": "Seconds to follow" });
    const follow = button("Follow the last", () => look(window_.span ? {} : { span: Math.max(1e-9, Number(span.value) || 10) }), { "aria-pressed": "false" });
    span.onchange = () => window_.span && look({ span: Math.max(1e-9, Number(span.value) || 10) });
    const all = button("All", () => look({}), { "aria-pressed": "true" });
    const wires = element("input", { type: "checkbox", checked: true, onchange: () => fetchValues() });
    const ghosts = element("div", { class: "scope-runs" });
    const summary = element("summary", {}, "Earlier runs");
    const file = element("input", { type: "file", accept: ".csv,text/csv", onchange: () => measured(file) });
    const path = element("input", { placeholder: "results.csv", "aria-label": "File for the results: .csv, .parquet or .mat", oninput: () => (save.textContent = "Save") });
    const save = button("Save", () => store(path, save));
    const at = element("output", { class: "scope-at" });
    const note = element("p", { class: "scope-note", role: "status" });
    const section = element("div", { class: "scope-bar", role: "toolbar", "aria-label": "Scopes" },
      signal, button("Open scope", open), element("datalist", { id: "scope-signals" }),
      all, follow, span, element("span", {}, "s"), button("−", () => zoom(2), { "aria-label": "Zoom out" }), button("+", () => zoom(0.5), { "aria-label": "Zoom in" }),
      element("label", {}, wires, " values on wires"), element("details", {}, summary, ghosts),
      element("label", { class: "file" }, "Measured CSV ", file), path, save, at, note);
    const empty = element("p", { class: "scope-empty" }, "No scope is open: click a wire, or choose a signal.");
    return { section, signal, follow, all, wires, ghosts, summary, at, note, empty };
  }

  function listSignals() {
    const options = [...(app.state.document?.signals ?? [])].map(({ name, unit }) => element("option", { value: name }, unit));
    for (const [name, { columns }] of files) options.push(...columns.map((column) => element("option", { value: `${name}|${column.name}` }, column.unit)));
    document.getElementById("scope-signals").replaceChildren(...options);
  }

  async function listRuns(answer) {
    answer ??= await quietly(ask("runs"));
    if (!answer) return;
    runs = answer.runs.filter((run) => !run.is_live);
    bar.summary.textContent = `Earlier runs (${runs.length})`;
    bar.ghosts.replaceChildren(...runs.map(({ id, label, is_shown: isShown }) => {
      const box = element("input", { type: "checkbox", checked: isShown });
      const take = (name, fields) => quietly(ask(name, fields)).then((told_) => {
        if (name === "forget" || !box.checked) scopes.forEach((scope) => scope.curves.delete(`ghost ${id}`) && scope.arrange());
        listRuns(told_);
        draw();
      });
      box.onchange = () => take("ghost", { run: id, on: box.checked });
      const forget = element("button", { type: "button", "aria-label": `Forget ${label}`, onclick: () => take("forget", { run: id }) }, "×");
      return element("div", {}, element("label", {}, box, ` ${label}`), forget);
    }));
    if (!runs.length) bar.ghosts.textContent = "There are none yet.";
  }

  async function measured(input) {
    const file = input.files[0];
    input.value = "";
    if (!file) return;
    try {
      if (file.size > 8 * 2 ** 20) throw new Error(`${file.name} is larger than 8 MiB. Leave out columns or rows.`);
      const answer = await ask("overlay", { name: file.name, text: await file.text() });
      files.set(file.name, answer);
      listSignals();
      const names = answer.columns.map(({ name }) => `${file.name}|${name}`);
      const used = [...scopes.values()].some((scope) => answer.columns.some(({ name }) => scope.signals.includes(name)));
      bar.note.textContent = used ? `${file.name} is shown over the scopes of its signals.` : `${file.name}: add its columns to a scope, as ${names[0]}.`;
    } catch (error) {
      told(error);
    }
  }

  function lose(name) {
    files.delete(name);
    listSignals();
    scopes.forEach((scope) => scope.curves.delete(`overlay ${name}`) && scope.arrange());
    draw();
  }

  async function store(path, save) {
    const name = path.value.trim() || path.placeholder;
    try {
      const answer = await ask("save", { path: name, replaces: save.textContent === "Replace" });
      save.textContent = "Save";
      bar.note.textContent = `The results are in ${answer.path}.`;
      app.announce(bar.note.textContent);
    } catch (error) {
      if (error.message.includes("is there already")) save.textContent = "Replace";
      told(error);
    }
  }

  // --- what happens elsewhere ------------------------------------------------------------------------------------

  let shownRun = 0;
  let shownState = "";
  app.on("document", () => {
    listSignals();
    scopes.forEach((scope) => scope.arrange());
  });
  app.on("run", (run) => {
    if (run.id !== shownRun || run.state !== shownState) listRuns();
    if (run.id !== shownRun) scopes.forEach((scope) => (scope.keys = "") || scope.curves.delete("events"));
    [shownRun, shownState] = [run.id, run.state];
    if (cursor === null && bar.wires.checked) fetchValues();
    if (window_.span || run.state !== "running") draw();
  });
  app.on("wire", (name) => name && app.openScope([name]));
  app.on("drawn", () => fetchValues());
  app.connection.on("hello", () => scopes.forEach(request)); // the server has forgotten them when the page comes again
  dark.addEventListener("change", () => {
    scopes.forEach((scope) => scope.swatches());
    draw();
  });
}
