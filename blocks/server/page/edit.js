/** Editing: commands and keys, forms in the panel, cures beside faults. Each gesture is one message and one step of undo. */
import { choose, prompted } from "./chooser.js";
import { element } from "./elements.js";
import * as hand from "./hand.js";

const TYPED = 700; // ms after which a value that is typed counts, without Return
const SHOWN = 60;

export function start(app) {
  /** Names on the open level that gestures are about: blocks and terminals. @type {Set<string>} */
  const picked = new Set();
  let palette = [];
  const level = () => app.state.level;
  const own = (path) => (path.startsWith(level() ? `${level()}.` : "") ? path.slice(level() ? level().length + 1 : 0) : "");

  /** Do a gesture; what is refused is said in a bar, too. @returns {Promise<any>} null where it was refused */
  async function act(name, fields = {}, said = "") {
    try {
      refusal.textContent = "";
      const told = await app.connection.ask(name, name === "undo" || name === "redo" ? fields : { level: level(), ...fields });
      app.announce(said || told.what || "");
      if (told.files?.length) say(`written into ${told.files.join(", ")}: every block of it is another one now`);
      return told;
    } catch (error) {
      app.drawing.show(level()); // as it stands
      say(error.message);
      return null;
    }
  }
  function say(text) {
    refusal.textContent = text;
    app.announce(text);
  }
  const edit = (operations, what = "") => act("edit", { operations, what });

  const mark = () => {
    for (const [name, box] of app.drawing.boxes()) box.classList.toggle("picked", picked.has(name));
    for (const [command, button] of buttons) button.disabled = !commands[command].can();
  };
  /** Choose names; the last one is shown in the panel. */
  function pick(names, isMore = false) {
    if (!isMore) picked.clear();
    names.forEach((name) => (isMore && picked.has(name) ? picked.delete(name) : picked.add(name)));
    const last = [...picked].at(-1);
    isPicking = true;
    app.drawing.choose(last === undefined ? {} : { box: last });
    isPicking = false;
    mark();
  }
  let isPicking = false;
  app.on("select", (path) => {
    if (isPicking) return;
    picked.clear();
    if (path && own(path) && !own(path).includes(".")) picked.add(own(path));
    mark();
  });
  app.on("wire", mark);
  app.on("drawn", () => {
    [...picked].forEach((name) => app.drawing.boxes().has(name) || picked.delete(name));
    mark();
  });

  // --- insertion ----------------------------------------------------------------------------------------------------

  const picture = ({ picture: strokes }) => element("svg:svg", { viewBox: "-20 -16 40 32", class: "pictogram", "aria-hidden": "true" },
    ...(strokes.length ? strokes : [["line", "M-14 -10H14V10H-14Z"]]).map(([style, d]) => element("svg:path", { class: style, d })));
  const title = (entry) => entry.type ?? entry.diagram ?? entry.fmu;
  /** The entries of the palette that a word means, the nearest first. */
  function meant(word) {
    const asked = word.toLowerCase();
    const rank = (entry) => {
      const name = title(entry).toLowerCase();
      const humps = title(entry).replace(/[^A-Z0-9]/g, "").toLowerCase();
      if (name === asked) return 0;
      if (name.startsWith(asked)) return 1 + name.length / 100;
      if (name.endsWith(asked)) return 2 + name.length / 100;
      if (humps.startsWith(asked) && asked.length > 1) return 3;
      if (name.includes(asked)) return 4;
      return `${entry.doc} ${entry.group}`.toLowerCase().includes(asked) ? 5 : 9;
    };
    return palette.map((entry) => [rank(entry), entry]).filter(([order]) => order < 9).sort(([a], [b]) => a - b).map(([, entry]) => entry);
  }
  const DEFINED = { input: "an input of the diagram", output: "an output: of the chosen signal", parameter: "a parameter of the diagram", measure: "a measure of runs" };
  /** Insert what is typed: a type with parameters, or an input, an output, a parameter. place: of a click, or of a wire. */
  app.insert = async (text, event = null, wire = {}) => {
    if (!palette.length) palette = (await app.ask("palette"))?.entries ?? [];
    const at = event ? hand.near(app, event) : {};
    choose(app, {
      label: "Insert", placeholder: "pid kp=20, gain 3, input r, ...", text,
      find: (said) => {
        const [word, rest] = [said.split(/\s/, 1)[0], said.replace(/^\S*\s*/, "")];
        const defined = Object.entries(DEFINED).filter(([kind]) => word && kind.startsWith(word.toLowerCase())).map(([kind, told]) => ({
          name: kind, told: rest ? `${kind} ${rest}` : told, go: () => define(kind, rest),
        }));
        const entries = meant(word).slice(0, SHOWN).map((entry) => ({
          name: title(entry), told: rest || entry.doc, picture: picture(entry), go: () => add(entry, rest, { ...at, ...wire }),
        }));
        return defined.some(({ name }) => name === word) ? [...defined, ...entries] : [...entries, ...defined];
      },
    });
  };
  async function add({ type, diagram, fmu }, text, where) {
    const entry = Object.fromEntries(Object.entries({ type, diagram, fmu }).filter(([, value]) => value));
    const told = await act("insert", { entry, text, ...where });
    if (told) pick(told.names);
  }
  async function define(kind, text) {
    const said = text || (await prompted({ input: "Name of the input", output: "Name of the output", parameter: "Parameter, as in kp=20 V", measure: 'Measure, as in peak={"type": "peak", "of": "motor.omega"}' }[kind]));
    if (!said) return;
    const source = kind === "output" ? chosenSource() : "";
    if (kind === "output" && !source) return say("Choose the signal that the output gives first: its wire, or its block.");
    await act("define", { kind, text: said, source });
  }
  /** The signal on the open level that is chosen, or the first output of the chosen block. */
  const chosenSource = () => (app.state.wire && own(app.state.wire)) || [...picked].flatMap((name) => hand.ports(app, name, "out"))[0]?.port || "";

  // --- wires by keys ------------------------------------------------------------------------------------------------

  /** Choose what a port is wired to. */
  app.connect = async (port, kind = "") => {
    const told = await app.ask("targets", { end: port, kind, level: level() });
    if (!told) return;
    const entries = Object.entries(told.ports).map(([name, why]) => ({ name, told: "", why, go: () => wire(...(told.source ? [port, name] : [name, port])) }));
    if (told.source) entries.push(...outputs().map((name) => ({ name, told: "output of the diagram", why: "", go: () => wire(port, name) })));
    entries.sort((a, b) => Boolean(a.why) - Boolean(b.why));
    choose(app, { label: told.source ? `Connect ${port} to` : `Connect ${port} from`, placeholder: "Port", find: (text) => entries.filter(({ name }) => name.toLowerCase().includes(text.toLowerCase())).slice(0, SHOWN) });
  };
  const outputs = () => [...app.drawing.boxes()].filter(([, box]) => box.classList.contains("output")).map(([name]) => name);
  /** A wire from a source to an input, or to an output of the diagram; before: where its end was. */
  const wire = (source, sink, before = null) =>
    edit([...(before ? [{ unwire: before }] : []), sink.includes(".") ? { wire: source, to: sink } : { set: ["outputs", sink], to: source }], `wire ${source} to ${sink}`);
  function connect() {
    const [name] = picked;
    if (name === undefined) return say("Select a block first.");
    const driven = hand.driven(app);
    const free = hand.ports(app, name, "in").filter(({ port }) => !driven.has(port));
    const all = [...hand.ports(app, name, "out").map(({ port }) => [port, "out"]), ...free.map(({ port }) => [port, "in"])];
    if (!all.length) return say(`${name} has no port that is free.`);
    if (all.length === 1) return app.connect(...all[0]);
    choose(app, { label: `Port of ${name}`, placeholder: "Port", find: (text) => all.filter(([port]) => port.includes(text)).map(([port, kind]) => ({ name: port, told: kind === "out" ? "output" : "input, not wired", go: () => app.connect(port, kind) })) });
  }
  /** The block behind or before the chosen one, along a wire. */
  function along(isForward) {
    const [name] = picked;
    const wires = [...app.drawing.stage.querySelectorAll("g.wire[data-sink]")].map(({ dataset }) => [dataset.net.split(/[.[]/)[0], dataset.sink.split(/[.[]/)[0]]);
    const next = [...new Set(wires.filter((ends) => ends[isForward ? 0 : 1] === name).map((ends) => ends[isForward ? 1 : 0]))];
    if (!next.length) return say(`No wire leads ${isForward ? "on from" : "to"} ${name}.`);
    pick([next[0]]);
    app.announce(`${next[0]}${next.length > 1 ? `, one of ${next.join(", ")}` : ""}`);
  }

  // --- commands -----------------------------------------------------------------------------------------------------

  const blocks = () => [...picked].filter((name) => app.block(app.drawing.full(name)));
  const some = () => picked.size > 0;
  async function copy() {
    const told = await app.ask("copy", { names: [...picked], level: level() });
    if (!told) return false;
    copied = told.text;
    await navigator.clipboard?.writeText(copied).catch(() => null); // where the browser lets it
    app.announce(`${[...picked].join(", ")} copied.`);
    return true;
  }
  let copied = "";
  async function paste(text) {
    const told = text ? await act("paste", { text }) : say("Nothing was copied.");
    if (told) pick(told.names);
  }
  async function remove() {
    const sinks = !picked.size && app.state.wire ? (app.state.sink ? [app.state.sink] : [...hand.driven(app)].filter(([, source]) => source === own(app.state.wire)).map(([sink]) => sink)) : [];
    const names = [...picked];
    if (!names.length && !sinks.length) return;
    const told = await act("delete", { names, sinks });
    if (told) pick([]);
  }
  async function rename() {
    const [name] = picked;
    const to = await hand.typedOver(app, name);
    if (!to || to === name) return;
    const section = app.block(app.drawing.full(name)) ? "blocks" : app.drawing.boxes().get(name).classList.contains("input") ? "inputs" : "outputs";
    if (await edit([{ rename: [section, name], to }], `rename ${name} to ${to}`)) pick([to]);
  }
  async function group() {
    const names = blocks();
    const as = await prompted("Name of the subdiagram", "group");
    if (as && (await edit([{ group: names, as }], `group ${names.join(", ")}`))) pick([as]);
  }
  const commands = {
    insert: { text: "Add", keys: "letters", what: "insert a block by its name; also a double click on free ground", go: () => app.insert(""), can: () => true },
    connect: { text: "Connect", keys: "Shift+C", what: "wire the selected block", go: connect, can: () => blocks().length > 0 },
    remove: { text: "Delete", keys: "Delete", what: "delete what is selected", go: remove, can: () => some() || app.state.wire !== null },
    rename: { text: "Rename", keys: "F2", what: "rename the selected block", go: rename, can: () => picked.size === 1 },
    duplicate: { text: "Duplicate", keys: "Ctrl+D", what: "duplicate what is selected", go: async () => pick((await act("duplicate", { names: [...picked] }))?.names ?? [...picked]), can: some },
    group: { text: "Group", keys: "Ctrl+G", what: "make a subdiagram of the selected blocks", go: group, can: () => blocks().length > 0 },
    ungroup: { text: "Ungroup", keys: "Ctrl+Shift+G", what: "put the blocks of a subdiagram in its place", go: () => edit([{ ungroup: [...picked][0] }], `ungroup ${[...picked][0]}`), can: () => app.block(app.state.selected)?.kind === "diagram" && picked.size === 1 },
    arrange: { text: "Lay out", keys: "Shift+L", what: "lay out what is selected, or all", go: () => act("arrange", { names: [...picked] }), can: () => true },
    undo: { text: "Undo", keys: "Ctrl+Z", what: "undo", go: () => act("undo"), can: () => Boolean(app.state.document?.editing?.undo) },
    redo: { text: "Redo", keys: "Ctrl+Y", what: "redo; also Ctrl+Shift+Z", go: () => act("redo"), can: () => Boolean(app.state.document?.editing?.redo) },
    open: { text: "Diagrams", keys: "", what: "open another diagram of the folder", go: () => others(), can: () => true },
  };
  async function others() {
    palette = (await app.ask("palette"))?.entries ?? [];
    const found = palette.filter(({ diagram }) => diagram);
    const go = (diagram) => async () => {
      const tab = window.open("about:blank"); // now, while the click counts
      const told = await app.ask("tab", { file: diagram });
      if (told) tab ? (tab.location = told.url) : location.assign(told.url);
      else tab?.close();
    };
    choose(app, { label: "Open a diagram in a tab", placeholder: "Diagram", find: (text) => found.filter(({ diagram }) => diagram.includes(text)).map(({ diagram }) => ({ name: diagram, told: "", go: go(diagram) })) });
  }
  const buttons = new Map();
  const refusal = element("output", { class: "refusal" });
  const bar = element("div", { id: "edits", role: "toolbar", "aria-label": "Edit", hidden: true });
  for (const [name, { text, keys, what, go }] of Object.entries(commands)) {
    buttons.set(name, element("button", { type: "button", title: `${what[0].toUpperCase()}${what.slice(1)}${keys ? ` (${keys})` : ""}`, onclick: go }, text));
    bar.append(buttons.get(name));
  }
  bar.append(refusal);

  // --- keys ---------------------------------------------------------------------------------------------------------

  const shortcuts = (event) => {
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey) {
      if (key === "z") return event.shiftKey ? "redo" : "undo";
      return { y: "redo", d: "duplicate", g: event.shiftKey ? "ungroup" : "group" }[key];
    }
    return { Delete: "remove", F2: "rename", L: "arrange", C: "connect" }[event.key];
  };
  let nudge = [0, 0];
  let isNudging = false;
  /** One message at a time: what is pressed meanwhile is one move. */
  async function nudged(arrow) {
    nudge = [nudge[0] + 10 * arrow[0], nudge[1] + 10 * arrow[1]];
    if (isNudging) return;
    isNudging = true;
    while (nudge[0] || nudge[1]) {
      const by = nudge;
      nudge = [0, 0];
      await act("place", { names: [...picked], by });
    }
    isNudging = false;
  }
  /** A key in the drawing; whether it was one of editing. */
  const key = (event, arrow) => {
    const isHeld = event.ctrlKey || event.metaKey;
    if (arrow && isHeld && picked.size) along(arrow[0] + arrow[1] > 0);
    else if (arrow && !event.shiftKey && !isHeld && !event.altKey && picked.size) nudged(arrow);
    else if (event.key === "Backspace" && (picked.size || app.state.wire)) remove();
    else if (isHeld && event.key.toLowerCase() === "a") pick([...app.drawing.boxes().keys()]);
    else if (isHeld && event.key.toLowerCase() === "c" && picked.size) copy();
    else if (isHeld && event.key.toLowerCase() === "x" && picked.size) copy().then((isCopied) => isCopied && remove());
    else if (/^[a-z]$/.test(event.key) && !isHeld && !event.altKey) app.insert(event.key);
    else return false;
    return true;
  };
  document.addEventListener("keydown", (event) => {
    if (bar.hidden || event.defaultPrevented || event.target.closest("input:not([type=range]), textarea, select, dialog, #scopes, #analysis")) return;
    const name = shortcuts(event);
    if (!name) return;
    event.preventDefault();
    if (commands[name].can()) commands[name].go();
  });
  document.addEventListener("paste", (event) => {
    if (bar.hidden || event.target.closest?.("input, textarea")) return;
    event.preventDefault();
    paste(event.clipboardData.getData("text/plain") || copied);
  });

  // --- values -------------------------------------------------------------------------------------------------------

  /** Write a parameter as typed. made: what shows it, and what is refused. */
  async function put(path, value, made) {
    const text = Array.isArray(value) ? `[${value.join(", ")}]` : String(value);
    const steps = path.split(".");
    const at = steps.slice(0, -2).join(".");
    try {
      const { later } = await app.connection.ask("put", { level: at, name: steps.slice(-2).join("."), text });
      made.refuse();
      app.announce(`${path} is ${text || "as its type has it"}${later ? `. Not in this run: ${later}` : ""}`);
      return true;
    } catch (error) {
      made.refuse(error.faults?.map(({ code, message, cure }) => `${code} ${message} ${cure}`).join(" ") ?? error.message);
      return false;
    }
  }
  /** The field of a parameter that no knob shows: an expression, or one of a diagram that has faults. */
  const field = (path, kind, { name, text, knob }) => {
    const isOwn = !app.block(path);
    if (!(kind === "Parameters" || (kind === "Inputs" && isOwn)) || (knob && !knob.bound)) return null;
    const full = path ? `${path}.${name}` : name;
    const made = element("input", { type: "text", "aria-label": full, autocomplete: "off", spellcheck: "false" });
    made.value = text === "not wired" ? "" : text.replace(/^not wired: /, "");
    const error = element("span", { class: "error", role: "alert" });
    made.refuse = (...words) => {
      error.replaceChildren(...words);
      made.ariaInvalid = words.length ? "true" : null;
    };
    let [timer, taken] = [0, made.value];
    const take = () => {
      clearTimeout(timer);
      if (made.value === taken) return;
      taken = made.value;
      put(full, made.value, made);
    };
    made.oninput = () => {
      clearTimeout(timer);
      timer = setTimeout(take, TYPED);
    };
    made.onchange = take;
    const drop = isOwn ? element("button", { class: "link", onclick: () => edit([{ remove: [kind.toLowerCase(), name] }], `delete ${name}`) }, "Delete") : null;
    return element("span", { class: "field" }, made, drop, error);
  };
  /** What a diagram says beside its blocks: what is logged, measured, and when a run ends. */
  const forms = (panel, selected) => {
    if (selected || !panel.run) return null;
    const line = (name, text, ...more) => element("li", {}, element("span", { class: "name" }, name), element("span", { class: "value" }, text, " ", ...more));
    const gone = (place, what) => element("button", { class: "link", "aria-label": `Delete ${what}`, onclick: () => edit([{ remove: place }], `delete ${what}`) }, "Delete");
    const change = (place, what, text) => element("button", { class: "link", "aria-label": `Change ${what}`, onclick: async () => {
      const said = await prompted(what, text);
      if (said) await act("define", { kind: "entry", text: `${place}=${said}` });
    } }, "Change");
    const log = panel.run.log.map((name, index) => line(name, "logged", gone(["run", "log", index], name)));
    const chosen = app.state.wire && !panel.run.log.includes(app.state.wire) ? element("button", { onclick: () => edit([panel.run.hasLog ? { add: ["run", "log", panel.run.log.length], value: app.state.wire } : { set: ["run", "log"], to: [app.state.wire] }], `log ${app.state.wire}`) }, `Log ${app.state.wire}`) : null;
    return element("details", { class: "doc", open: panel.open ?? false }, element("summary", {}, element("h3", {}, "Runs, log and measures")),
      element("ul", { class: "rows" },
        ...["stop", "every", "method"].map((name) => line(name, panel.run[name], change(`run.${name}`, name, panel.run[name]))),
        ...log, ...Object.entries(panel.run.measures).map(([name, text]) => line(name, text, change(`measures.${name}`, name, text), gone(["measures", name], name)))),
      chosen, element("button", { onclick: () => define("measure", "") }, "Add a measure"));
  };
  /** The button beside a fault that does what its cure says. */
  const remedy = ({ remedy: found }) => found && element("button", { class: "remedy", onclick: (event) => {
    event.stopPropagation();
    return found.sink ? connectAt(found.sink) : act("edit", { level: "", operations: found.operations, what: found.label });
  } }, found.label);
  async function connectAt(sink) {
    const at = sink.split(".").slice(0, -2).join(".");
    if (at !== level()) await app.open(at);
    app.connect(sink.split(".").slice(-2).join("."), "in");
  }

  app.on("document", (told) => {
    if (!told.editing || !bar.hidden) return mark();
    bar.hidden = false;
    document.getElementById("drawing").prepend(bar);
    document.body.classList.add("edits");
    hand.start(app, { picked, pick, act, say, wire });
    Object.assign(app, { key, put, field, forms, remedy, chosen: (path, name) => ["edit", { level: path.split(".").slice(0, -1).join("."), operations: [name === "base" ? { remove: ["blocks", path.split(".").pop(), "variant"] } : { set: ["blocks", path.split(".").pop(), "variant"], to: name }], what: `variant ${name}` }] });
    for (const { keys, what } of Object.values(commands)) if (keys) app.keys.push([keys, what]);
    app.keys.push(["Ctrl+C Ctrl+X Ctrl+V", "copy, cut and paste, also as text"], ["Ctrl+arrow", "along a wire to the next block"], ["arrows", "move what is selected"], ["Shift+R Shift+S Shift+F Shift+B", "run anew, stop, show all, analysis: letters insert blocks"]);
    mark();
  });
}
