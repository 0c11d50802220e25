/** Scopes: signals over a shared time axis, with a cursor, ghosts of earlier runs, measured files, events. */
import { element } from "./elements.js";
import { Scope, dark, seconds, short } from "./scope.js";

const TURN = 33; // ms between two frames that are asked for
const NUMBERS = 150; // ms between two looks at the numbers
const LARGEST = 8 * 2 ** 20; // bytes of a measured file

/** @param {any} app */
export function start(app) {
  /** @type {Map<string, Scope>} */
  const scopes = new Map();
  const files = new Map(); // measured ones, as the server tells them
  let runs = []; // earlier ones
  let band = null; // of a sweep
  let view = {}; // {}: all; {span}: the last; {t0, t1}
  let [cursor, isPinned] = [null, false];
  let number = 0;
  const ask = (name, fields) => app.connection.ask(name, fields);
  const quietly = (promise) => promise.catch(() => null);
  const each = (act) => scopes.forEach(act);
  const note = (text) => {
    noted.textContent = text;
    app.announce(text);
  };
  const run = () => (app.state.run?.id ? app.state.run : null);

  // --- the time that is shown ------------------------------------------------------------------------------------

  const last = () => Math.max(...[...scopes.values()].flatMap(({ curves }) => [...curves.values()].map((curve) => curve.last)), -Infinity);
  /** The span of time that is shown, in s. */
  function shown() {
    if (view.t1 !== undefined) return [view.t0, view.t1];
    const settings = app.state.document?.settings ?? {};
    const begin = run()?.start ?? settings.start ?? 0;
    const stop = (run() ? run().stop : settings.stop) ?? -Infinity;
    if (view.span) {
      const now = Math.max(begin, ...[...scopes.values()].map(({ curves }) => curves.get("run")?.last ?? begin));
      return [Math.max(begin, now - view.span), Math.max(now, begin + view.span)];
    }
    const end = Math.max(stop, last());
    return [begin, end > begin ? end : begin + 1];
  }

  let later = 0;
  function look(next) {
    view = next;
    follow.setAttribute("aria-pressed", String(view.span !== undefined));
    all.setAttribute("aria-pressed", String(view.span === undefined && view.t1 === undefined));
    draw();
    clearTimeout(later);
    later = setTimeout(() => each(request), 60);
  }
  /** Zoom about a time; factor < 1 shows less. */
  function zoom(factor, about = cursor) {
    const [t0, t1] = shown();
    const at = about !== null && about >= t0 && about <= t1 ? about : (t0 + t1) / 2;
    if (factor > 1 || (t1 - t0) * factor > 1e-12 * Math.max(Math.abs(t0), Math.abs(t1), 1e-6)) look({ t0: at - (at - t0) * factor, t1: at + (t1 - at) * factor });
  }
  function pan(part) {
    const [t0, t1] = shown();
    look({ t0: t0 + part * (t1 - t0), t1: t1 + part * (t1 - t0) });
  }
  const request = (scope) => ask("scope", { scope: scope.id, signals: scope.signals, width: Math.max(16, scope.plot.clientWidth), ...view }).catch((error) => note(error.message));

  // --- the cursor ------------------------------------------------------------------------------------------------

  function point(t, speaks = false) {
    cursor = t;
    isPinned &&= t !== null;
    app.emit("cursor", t);
    at.textContent = t === null ? "" : `t = ${seconds(t)}${isPinned ? ", pinned" : ""}`;
    each((scope) => scope.place());
    fetchValues(speaks);
  }

  let [isAsked, askedAt] = [false, 0];
  /** Values at the cursor, or at the end of the run; one question at a time, of which the last one counts. */
  async function fetchValues(speaks = false) {
    if (isAsked) return;
    const t = cursor;
    const time = t ?? run()?.t;
    isAsked = true;
    askedAt = performance.now();
    const answer = time == null ? null : await quietly(ask("values", { t: time }));
    isAsked = false;
    if (t !== cursor) return fetchValues(speaks);
    each((scope) => scope.tell(answer?.values ?? {}));
    onWires(wires.checked && answer ? answer.values : {});
    if (speaks && cursor !== null) app.announce(`${seconds(cursor)}. ${[...scopes.values()].map(({ spoken }) => spoken).join(". ")}`);
  }

  /** @type {Map<string, Element>} labels beside the beginnings of wires, by signal */
  let labels = new Map();
  function label(drawing) {
    labels = new Map();
    const level = app.state.level ? `${app.state.level}.` : "";
    for (const wire of drawing?.querySelectorAll("g[data-net]") ?? []) {
      const [name, line] = [level + wire.dataset.net, wire.querySelector("path.run")];
      if (!line || labels.has(name)) continue;
      const made = document.createElementNS("http://www.w3.org/2000/svg", "text");
      const { x, y } = line.getPointAtLength(4);
      Object.entries({ class: "wire-value", x, y: y - 4, "aria-hidden": "true" }).forEach(([key, value]) => made.setAttribute(key, value));
      labels.set(name, made);
      wire.parentNode.append(made);
    }
    fetchValues();
  }
  function onWires(values) {
    for (const [name, made] of labels) {
      const some = name in values ? [values[name]].flat() : [];
      const text = some.slice(0, 3).map((one) => short(one ?? NaN)).join(", ") + (some.length > 3 ? ", ..." : "");
      if (made.textContent !== text) made.textContent = text;
    }
  }

  // --- scopes ----------------------------------------------------------------------------------------------------

  let most = 1; // axes of a scope
  const host = {
    shown, look, zoom, pan, keys, run, ask: request,
    all: () => look({}), cursor: () => cursor, band: () => band,
    hover: (t) => isPinned || point(t),
    pin() {
      isPinned = !isPinned && cursor !== null;
      point(cursor);
    },
    unit: (name) => app.state.document?.signals.find((one) => one.name === name)?.unit ?? "",
    label: (id) => runs.find((one) => one.id === id)?.label ?? `run ${id}`,
    arranged() {
      if (host.axes() === most) return;
      most = host.axes();
      each((scope) => scope.u?.redraw(false, true));
    },
    axes: () => Math.max(1, ...[...scopes.values()].map(({ units }) => units.length)),
    remove(scope) {
      quietly(ask("unscope", { scope: scope.id }));
      scopes.delete(scope.id);
      scope.u?.destroy();
      scope.section.remove();
      empty.hidden = scopes.size > 0;
      ([...scopes.values()].at(-1)?.plot ?? signal).focus();
    },
    lose: (name) => quietly(ask("unoverlay", { name })).then(() => {
      files.delete(name);
      listSignals();
      drop(`overlay ${name}`);
    }),
  };
  /** Curves of that key are no more. */
  function drop(key) {
    each((scope) => scope.curves.delete(key) && scope.arrange());
    draw();
  }

  /** Open a scope of some signals, or go to the one that has them. add: to the newest scope. */
  app.openScope = (signals, { add = false } = {}) => {
    const newest = [...scopes.values()].at(-1);
    if (add && newest) return signals.forEach((name) => newest.include(name));
    let scope = [...scopes.values()].find((one) => signals.every((name) => one.signals.includes(name)));
    if (!scope) {
      scope = new Scope(String((number += 1)), [...signals], host);
      scopes.set(scope.id, scope);
      list.append(scope.section);
      scope.arrange();
      empty.hidden = true;
      request(scope);
      app.announce(`A scope of ${signals.join(", ")} is open.`);
    }
    return scope.section.scrollIntoView({ block: "nearest" });
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
    const go = (t) => {
      isPinned = true;
      point(Math.min(Math.max(t, t0), t1), true);
    };
    const from = cursor ?? (t0 + t1) / 2;
    const act = {
      ArrowLeft: () => go(from - step), ArrowRight: () => go(from + step), Home: () => go(t0), End: () => go(t1),
      "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: () => look({}), PageUp: () => pan(-0.5), PageDown: () => pan(0.5),
      f: () => follow.click(), Escape: () => point(null),
    }[event.key];
    if (!act) return;
    act();
    event.preventDefault();
    event.stopPropagation();
  }

  // --- drawing, as often as there is something new ---------------------------------------------------------------

  let [isDue, mustAnswer, answeredAt, toldAt, telling] = [false, false, 0, 0, 0];
  function draw() {
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      const span = shown();
      each((scope) => scope.show(span));
      telling ||= setTimeout(tell, Math.max(0, NUMBERS - performance.now() + toldAt));
      if (!mustAnswer) return;
      mustAnswer = false;
      setTimeout(() => {
        answeredAt = performance.now();
        quietly(ask("drawn"));
      }, Math.max(0, TURN - performance.now() + answeredAt));
    });
  }
  function tell() {
    [telling, toldAt] = [0, performance.now()];
    each((scope) => scope.tell());
  }
  app.connection.onFrame((frame) => {
    mustAnswer = true;
    scopes.get(frame.header.scope)?.take(frame, view.span ? shown()[0] - view.span : -Infinity);
    draw();
  });

  // --- earlier runs, measured files, results ---------------------------------------------------------------------

  function listSignals() {
    const own = (app.state.document?.signals ?? []).map(({ name, unit }) => element("option", { value: name }, unit));
    const measured = [...files].flatMap(([file, { columns }]) => columns.map(({ name, unit }) => element("option", { value: `${file}|${name}` }, unit)));
    known.replaceChildren(...own, ...measured);
  }

  async function listRuns(told) {
    const answer = told ?? (await quietly(ask("runs")));
    for (const one of [earlier.parentNode, file.parentNode, path, save]) one.hidden = !answer; // a page without a server
    if (!answer) return;
    runs = answer.runs.filter((one) => !one.is_live);
    earlier.textContent = `Earlier runs (${runs.length})`;
    const take = (name, id, fields) => quietly(ask(name, { run: id, ...fields })).then((after) => {
      if (!fields?.on) drop(`ghost ${id}`);
      listRuns(after);
    });
    ghosts.replaceChildren(...runs.map(({ id, label: text, is_shown: isShown }) => {
      const box = element("input", { type: "checkbox", checked: isShown, onchange: () => take("ghost", id, { on: box.checked }) });
      const forget = element("button", { "aria-label": `Forget ${text}`, onclick: () => take("forget", id) }, "×");
      return element("div", {}, element("label", {}, box, ` ${text}`), forget);
    }));
    if (!runs.length) ghosts.textContent = "There are none yet: run again.";
    each((scope) => scope.arrange());
  }

  async function measure() {
    const [chosen] = file.files;
    if (!chosen) return;
    try {
      if (chosen.size > LARGEST) throw new Error(`${chosen.name} is larger than 8 MiB. Leave out columns or rows.`);
      const answer = await ask("overlay", { name: chosen.name, text: await chosen.text() });
      files.set(chosen.name, answer);
      listSignals();
      const isUsed = answer.columns.some(({ name }) => [...scopes.values()].some((scope) => scope.signals.includes(name)));
      note(isUsed ? `${chosen.name} is shown over its signals.` : `Add columns of ${chosen.name} to a scope, as ${chosen.name}|${answer.columns[0].name}.`);
    } catch (error) {
      note(error.message);
    }
    file.value = "";
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
  const file = element("input", { type: "file", accept: ".csv,text/csv", class: "visually-hidden", onchange: measure });
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

  let [shownRun, shownState] = [0, ""];
  app.on("document", listSignals);
  app.on("run", (now) => {
    if (now.id && !shownRun && !number) {
      const logged = (app.state.document?.settings.log ?? []).filter((name, _k, [first]) => host.unit(name) === host.unit(first));
      if (logged.length) app.openScope(logged.slice(0, 3));
    }
    if (now.id !== shownRun || now.state !== shownState) listRuns();
    const isQuiet = now.state !== "running" || performance.now() - askedAt > NUMBERS;
    [shownRun, shownState] = [now.id, now.state];
    if (cursor === null && wires.checked && isQuiet) fetchValues();
    draw();
  });
  // With the analysis open, a click on a wire chooses its loop.
  app.on("wire", (name) => name && document.getElementById("analysis").hidden && app.openScope([name]));
  app.on("drawn", label);
  dark.addEventListener("change", () => {
    each((scope) => scope.swatches());
    draw();
  });
}
