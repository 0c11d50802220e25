/** Scopes: signals over a shared time axis, with a cursor, ghosts of earlier runs, measured files, events. */
import { Curve } from "./curves.js";
import { element, seconds } from "./elements.js";
import { Scope, dark, short } from "./scope.js";

const TURN = 33; // ms between two frames that are asked for
const NUMBERS = 150; // ms between two looks at the numbers
const [SHOWN, MOST] = [3, 100]; // elements of a signal on its wire, and where the pointer is on them
const LARGEST = 8 * 2 ** 20; // bytes of a measured file

/** @param {any} app */
export function start(app) {
  /** @type {Scope[]} */
  let scopes = [];
  const files = new Map(); // measured ones, as the server tells them
  const bands = new Map(); // of a sweep, by signal and element
  let runs = []; // earlier ones
  let view = {}; // {}: all; {span}: the last; {t0, t1}
  let [cursor, isPinned, number] = [null, false, 0];
  const ask = (name, fields) => app.connection.ask(name, fields);
  const quietly = (promise) => promise.catch(() => null);
  const noting = (promise) => promise.catch((error) => note(error.message));
  const note = (text) => {
    noted.textContent = text;
    app.announce(text);
  };
  const run = () => (app.state.run?.id ? app.state.run : null);

  // --- the time that is shown ------------------------------------------------------------------------------------

  /** The span of time that is shown, in s. */
  function shown() {
    if (view.t1 !== undefined) return [view.t0, view.t1];
    const { start: begin = 0, stop } = run() ?? app.state.document?.settings ?? {};
    const last = Math.max(begin, ...scopes.flatMap(({ curves }) => [...curves.values()].filter(({ header }) => !view.span || header.kind === "run").map((curve) => curve.last)));
    if (view.span) return [Math.max(begin, last - view.span), Math.max(last, begin + view.span)];
    const end = Math.max(stop ?? begin, last);
    return [begin, end > begin ? end : begin + 1];
  }

  let later = 0;
  function look(next) {
    view = next;
    follow.setAttribute("aria-pressed", String(view.span !== undefined));
    all.setAttribute("aria-pressed", String(view.span === undefined && view.t1 === undefined));
    draw();
    clearTimeout(later);
    later = setTimeout(() => scopes.forEach(pane.ask), 60);
  }
  /** Zoom about a time; factor < 1 shows less. */
  function zoom(factor, about = cursor) {
    const [t0, t1] = shown();
    const at = about !== null && about >= t0 && about <= t1 ? about : (t0 + t1) / 2;
    if (factor > 1 || (t1 - t0) * factor > 1e-12 * Math.max(Math.abs(t0), Math.abs(t1), 1e-6)) look({ t0: at - (at - t0) * factor, t1: at + (t1 - at) * factor });
  }
  function pan(share) {
    const [t0, t1] = shown();
    look({ t0: t0 + share * (t1 - t0), t1: t1 + share * (t1 - t0) });
  }

  // --- the cursor and the values at it ---------------------------------------------------------------------------

  function point(t, speaks = false) {
    cursor = t;
    isPinned &&= t !== null;
    app.emit("cursor", t);
    at.textContent = t === null ? "" : `t = ${seconds(t, shown())}${isPinned ? ", pinned" : ""}`;
    scopes.forEach((scope) => scope.place());
    fetchValues(speaks);
  }

  let [isAsked, isWanted, askedAt, values, others] = [false, false, 0, {}, {}];
  /** Values at the cursor, or at the end of the run; one question at a time, of which the last one counts. */
  async function fetchValues(speaks = false) {
    isWanted = isAsked;
    if (isAsked) return;
    [isAsked, askedAt] = [true, performance.now()];
    const t = cursor ?? run()?.t;
    const answer = t === undefined ? null : await quietly(ask("values", { t }));
    isAsked = false;
    if (isWanted) return fetchValues(speaks);
    [values, others] = [answer?.values ?? {}, answer?.others ?? {}];
    app.emit("values", values);
    tell();
    for (const [name, label] of labels) {
      const all = Object.hasOwn(values, name) && wires.checked ? [values[name]].flat() : [];
      if (!label.made && all.length) label.line.parentNode.append((label.made = beside(label.line)));
      if (!label.made) continue;
      const [some, more] = [SHOWN, MOST].map((count) => all.slice(0, count).map((one) => short(one ?? NaN)).join(", ") + (all.length > count ? ", ..." : ""));
      label.made.classList.toggle("cut", all.length > SHOWN);
      label.made.replaceChildren(some, all.length > SHOWN ? element("svg:title", {}, `${name}, ${all.length} elements: ${more}`) : "");
    }
    if (speaks && cursor !== null) app.announce(`${seconds(cursor, shown())}. ${scopes.map(({ spoken }) => spoken).join(". ")}`);
  }

  /** Labels beside the beginnings of wires, by signal, which are made when there is a value. @type {Map<string, any>} */
  const labels = new Map();
  const beside = (line) => {
    const [x, y, next] = line.getAttribute("d").match(/[-.\d]+/g).map(Number);
    return element("svg:text", { class: "wire-value", x: x + 4 * Math.sign(next - x), y: y - 4, "aria-hidden": "true" });
  };
  function label(drawing) {
    labels.clear();
    const level = app.state.level ? `${app.state.level}.` : "";
    for (const wire of drawing?.querySelectorAll("g[data-net]") ?? []) {
      const [name, line] = [level + wire.dataset.net, wire.querySelector("path.run")];
      // A wire that is kept when the drawing is shown anew has its label already.
      if (line && !labels.has(name)) labels.set(name, { line, made: line.parentNode.querySelector(".wire-value") });
    }
    fetchValues();
  }

  // --- what the scopes share -------------------------------------------------------------------------------------

  let most = 1; // axes of a scope
  const pane = {
    shown, look, zoom, pan, run,
    ask: ({ id, signals, plot }) => noting(ask("scope", { scope: id, signals, width: Math.max(16, plot.clientWidth), ...view })),
    cursor: () => cursor,
    band: (name) => bands.get(name),
    hover: (t) => isPinned || point(t),
    pin() {
      isPinned = !isPinned && cursor !== null;
      point(cursor);
    },
    label: (id) => runs.find((one) => one.id === id)?.label ?? `run ${id}`,
    axes: () => Math.max(1, ...scopes.map(({ units }) => units.length)),
    shape: (name) => app.state.document?.signals.find((one) => one.name === name)?.shape ?? [],
    arranged() {
      fetchValues();
      if (pane.axes() === most) return;
      most = pane.axes();
      scopes.forEach((scope) => scope.u?.redraw(false, true));
    },
    remove(scope) {
      pane.ask({ ...scope, signals: [] });
      scopes = scopes.filter((one) => one !== scope);
      scope.u?.destroy();
      scope.section.remove();
      empty.hidden = scopes.length > 0;
      (scopes.at(-1)?.plot ?? signal).focus();
    },
    async lose(name) {
      await quietly(ask("overlay", { name, text: null }));
      files.delete(name);
      listSignals();
      drop(`overlay ${name}`);
    },
    press(event) {
      const [t0, t1] = shown();
      const [from, step] = [cursor ?? (t0 + t1) / 2, ((t1 - t0) / 500) * (event.shiftKey ? 20 : 1)];
      const go = (t) => {
        isPinned = true;
        point(Math.min(Math.max(t, t0), t1), true);
      };
      const act = {
        ArrowLeft: () => go(from - step), ArrowRight: () => go(from + step), Home: () => go(t0), End: () => go(t1),
        "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: () => look({}), PageUp: () => pan(-0.5), PageDown: () => pan(0.5),
        f: () => follow.click(), Escape: () => point(null),
      }[event.key];
      if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
      act();
      event.preventDefault();
      event.stopPropagation();
    },
  };
  /** Curves of that key are no more. */
  function drop(key) {
    scopes.forEach((scope) => scope.curves.delete(key) && scope.arrange());
    draw();
  }

  /** Open a scope of some signals, or go to the one that has them. */
  app.openScope = (signals) => {
    let scope = scopes.find((one) => signals.every((name) => one.signals.includes(name)));
    if (!scope) {
      scope = new Scope(String((number += 1)), [...signals], pane);
      scopes.push(scope);
      list.append(scope.section);
      scope.arrange();
      empty.hidden = true;
      pane.ask(scope);
    }
    app.announce(`A scope of ${scope.signals.join(", ")} is open.`);
    scope.section.scrollIntoView({ block: "nearest" });
  };
  /** Show the band of a sweep over the scopes, as the server answers "band"; null takes it away. */
  app.showBand = (answer) => {
    bands.clear();
    for (const [name, levels] of Object.entries(answer?.signals ?? {})) {
      for (const k of levels[0].keys()) {
        const columns = levels.map((level) => Float32Array.from(level[k], (value) => value ?? NaN));
        bands.set(`${name},${k}`, new Curve({ t: answer.t, columns }));
      }
    }
    draw();
  };

  // --- drawing, as often as there is something new ---------------------------------------------------------------

  let [isDue, mustAnswer, answeredAt, telling] = [false, false, 0, 0];
  function draw() {
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      const span = shown();
      scopes.forEach((scope) => scope.show(span));
      telling ||= setTimeout(tell, NUMBERS);
      if (!mustAnswer) return;
      mustAnswer = false;
      setTimeout(() => {
        answeredAt = performance.now();
        quietly(ask("drawn"));
      }, Math.max(0, TURN - performance.now() + answeredAt));
    });
  }
  function tell() {
    telling = clearTimeout(telling);
    scopes.forEach((scope) => scope.tell(values, others[scope.id] ?? {}));
  }
  app.connection.onFrame((frame) => {
    mustAnswer = true;
    scopes.find(({ id }) => id === frame.header.scope)?.take(frame);
    draw();
  });

  // --- earlier runs, measured files, results ---------------------------------------------------------------------

  function listSignals() {
    const own = app.state.document?.signals ?? [];
    const measured = [...files].flatMap(([file, columns]) => columns.map(({ name, unit }) => ({ name: `${file}|${name}`, unit })));
    known.replaceChildren(...[...own, ...measured].map(({ name, unit }) => element("option", { value: name }, unit)));
  }

  async function listRuns(told = null) {
    const answer = told ?? (await quietly(ask("runs")));
    for (const one of [earlier.parentNode, file.parentNode, path, save]) one.hidden = !answer; // a page without a server
    if (!answer) return;
    runs = answer.runs.filter((one) => !one.is_live);
    earlier.textContent = `Earlier runs (${runs.length})`;
    ghosts.replaceChildren(...runs.map(({ id, label: text, is_shown: isShown }) => {
      const show = async (on, forget) => {
        const after = await quietly(ask("ghost", { run: id, on, forget }));
        if (!on) drop(`ghost ${id}`);
        listRuns(after);
      };
      const box = element("input", { type: "checkbox", checked: isShown, onchange: () => show(box.checked, false) });
      const forget = element("button", { "aria-label": `Forget ${text}`, onclick: () => show(false, true) }, "×");
      return element("div", {}, element("label", {}, box, ` ${text}`), forget);
    }));
    if (!runs.length) ghosts.textContent = "There are none yet: run again.";
    scopes.forEach((scope) => scope.arrange());
  }

  async function measure() {
    const [chosen] = file.files;
    if (!chosen) return;
    if (chosen.size > LARGEST) throw new Error(`${chosen.name} is larger than 8 MiB. Leave out columns or rows.`);
    const { name, columns } = await ask("overlay", { name: chosen.name, text: await chosen.text() });
    files.set(name, columns);
    listSignals();
    const isUsed = columns.some((column) => scopes.some((scope) => scope.signals.includes(column.name)));
    note(isUsed ? `${name} is shown over its signals.` : `Add columns of ${name} to a scope, as ${name}|${columns[0].name}.`);
  }

  async function store() {
    try {
      const answer = await ask("save", { path: path.value.trim() || path.placeholder, replaces: save.textContent === "Replace" });
      save.textContent = "Save";
      note(`The results are in ${answer.path}.`);
    } catch (error) {
      if (error.message.includes("is there already")) save.textContent = "Replace";
      note(error.message);
    }
  }

  // --- the bar ---------------------------------------------------------------------------------------------------

  const button = (text, title, act, more = {}) => element("button", { title, onclick: act, ...more }, text);
  const open = () => {
    const names = signal.value.split(/[\s;]+/).filter(Boolean);
    if (names.length) app.openScope(names);
    signal.value = "";
  };
  const signal = element("input", { list: "scope-signals", placeholder: "Signal", "aria-label": "Signals for a new scope", onkeydown: (event) => event.key === "Enter" && open() });
  const known = element("datalist", { id: "scope-signals" });
  const span = element("input", { type: "number", min: "0", step: "any", value: "10", "aria-label": "Seconds that are followed", onchange: () => view.span && look(lastSpan()) });
  const lastSpan = () => ({ span: Math.max(1e-9, Number(span.value) || 10) });
  const all = button("All", "The whole run (0)", () => look({}), { "aria-pressed": "true" });
  const follow = button("Last", "Follow the last seconds (F)", () => look(view.span ? {} : lastSpan()), { "aria-pressed": "false" });
  const wires = element("input", { type: "checkbox", checked: true, onchange: () => fetchValues() });
  const [earlier, ghosts] = [element("summary", {}, "Earlier runs"), element("div", { class: "scope-runs" })];
  const file = element("input", { type: "file", accept: ".csv,text/csv", class: "visually-hidden", onchange: () => noting(measure()).then(() => (file.value = "")) });
  const path = element("input", { placeholder: "results.csv", "aria-label": "File for the results: .csv, .parquet or .mat", oninput: () => (save.textContent = "Save") });
  const save = button("Save", "Write the results to a file in the folder of the diagram", store);
  const at = element("output", { class: "scope-at" });
  const noted = element("p", { class: "scope-note" });
  const empty = element("p", { class: "scope-note" }, "No scope is open: click a wire, or choose a signal.");
  const list = element("div", { class: "scope-list" });
  const bar = element("div", { class: "scope-bar", role: "toolbar", "aria-label": "Scopes" },
    signal, known, button("Open scope", "A scope of these signals", open), all, follow, span, "s",
    button("−", "Show more (-)", () => zoom(2), { "aria-label": "Zoom out" }), button("+", "Show less (+)", () => zoom(0.5), { "aria-label": "Zoom in" }), at,
    element("label", {}, wires, " values on wires"), element("details", {}, earlier, ghosts),
    element("label", { class: "file" }, file, "Measured CSV"), path, save);
  document.getElementById("scopes").append(bar, noted, empty, list);
  app.keys?.push(["← →", "in a scope: move its cursor (Shift: further); Esc takes it away"], ["+ -", "in a scope: zoom; 0 shows all, F follows"]);

  let was = "";
  app.on("document", listSignals);
  app.on("run", (now) => {
    if (now.id && !was && !number) {
      const unit = (name) => app.state.document.signals.find((one) => one.name === name)?.unit;
      const wanted = (app.state.document?.settings.first ?? []).filter((name, _k, [first]) => unit(name) === unit(first));
      if (wanted.length) app.openScope(wanted.slice(0, 3));
    }
    const state = now.id && `${now.id} ${now.state}`;
    if (state !== was) listRuns();
    was = state;
    if (now.state !== "running" || performance.now() - askedAt > NUMBERS) fetchValues(); // at a pinned cursor too
    draw();
  });
  // With the analysis open, a click on a wire chooses its loop; where wires are edited it selects them.
  app.on("wire", (name) => name && !app.state.document.editing && document.getElementById("analysis").hidden && app.openScope([name]));
  app.on("drawn", label);
  dark.addEventListener("change", () => {
    scopes.forEach((scope) => scope.arrange());
    draw();
  });
}
