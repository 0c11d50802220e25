/** Editing: commands and keys, forms in the panel, cures beside faults. Each gesture is one message and one step of undo. */
import { choose, prompted } from "./chooser.js";
import { element, give, isTyped, settle } from "./elements.js";
import * as pointer from "./pointer.js";

const TYPED = 700; // ms after which a value that is typed counts, without Return
const SHOWN = 60;

export function start(app) {
  /** Names on the open level that gestures are about: blocks and terminals. @type {Set<string>} */
  const picked = new Set();
  let [palette, measures] = [[], {}];
  const level = () => app.state.level;
  const own = (path) => (path.startsWith(level() ? `${level()}.` : "") ? path.slice(level() ? level().length + 1 : 0) : "");

  let doing = 0; // gestures without an answer
  const busy = (more) => document.getElementById("view").setAttribute("aria-busy", String((doing += more) > 0));
  /** Do a gesture; what is refused is said in a bar, too. @returns {Promise<any>} null where it was refused */
  async function act(name, fields = {}, said = "") {
    busy(1);
    try {
      refusal.textContent = "";
      const told = await app.connection.ask(name, name === "undo" || name === "redo" ? fields : { level: level(), ...fields });
      app.announce(said || told.what || "");
      if (told.files?.length) say(`written into ${told.files.join(", ")}: every block of it is another one now`);
      if (told.left?.length) say(`${told.left.join(", ")} name it too, and are left as they are: blocks apply --project changes them`);
      if (told.later) say(`not in this run: ${told.later}`);
      return told;
    } catch (error) {
      app.drawing.show(level()); // as it stands
      say(error.message);
      return null;
    } finally {
      busy(-1);
    }
  }
  function say(text) {
    refusal.textContent = text;
    app.announce(text);
  }
  const edit = (operations, what = "") => act("edit", { operations, what });

  const mark = () => {
    for (const [name, box] of app.drawing.boxes()) box.classList.toggle("picked", picked.has(name));
    app.emit("picked", [...picked].map(app.drawing.full));
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
    if (picked.size > 1) app.announce(`${picked.size} are selected: ${[...picked].slice(0, 6).join(", ")}${picked.size > 6 ? ", ..." : ""}`);
  }
  let isPicking = false;
  app.on("select", (path) => {
    if (isPicking) return;
    picked.clear();
    if (path && own(path) && !own(path).includes(".")) picked.add(own(path));
    mark();
  });
  app.on("wire", (name) => {
    if (name && !bar.hidden && !isPicking && picked.size) app.select(null); // one of both is edited
    mark();
  });
  app.on("drawn", () => {
    hint.hidden = app.drawing.boxes().size > 0;
    [...picked].forEach((name) => app.drawing.boxes().has(name) || picked.delete(name));
    mark();
  });

  const list = async () => {
    const told = await app.ask("palette");
    if (told) [palette, measures] = [told.entries, told.measures];
  };
  // --- insertion ----------------------------------------------------------------------------------------------------

  const picture = ({ picture: { size, strokes, texts } = { size: [50, 40], strokes: [["face", "M-25 -20H25V20H-25Z"]], texts: [] } }) => () => {
    const [width, height] = [size[0] + 20, Math.max(size[1], 40) + 4];
    return element("svg:svg", { viewBox: `${-width / 2} ${-height / 2} ${width} ${height}`, class: "pictogram", "aria-hidden": "true" },
      ...strokes.map(([style, d]) => element("svg:path", { class: style, d })),
      ...texts.map(([x, y, size, anchor, text]) => element("svg:text", { x, y, "font-size": size, "text-anchor": anchor }, text)));
  };
  const plain = (text) => text.toLowerCase().replace(/\W/g, "");
  const title = (entry) => entry.type ?? entry.diagram ?? entry.fmu ?? entry.word;
  /** The entries of the palette that a word means, the nearest first; without one all, by group. */
  function meant(word) {
    const asked = word.toLowerCase();
    if (!asked) return palette.filter((entry) => !entry.word);
    const rank = (entry) => {
      const names = [title(entry), ...(entry.words ?? [])].map(plain);
      const humps = title(entry).replace(/[^A-Z0-9]/g, "").toLowerCase();
      if (names.includes(asked)) return names.indexOf(asked) ? 0.5 : 0;
      if (names.some((name) => name.startsWith(asked))) return 1 + names[0].length / 100 + !names[0].startsWith(asked);
      if (names[0].endsWith(asked)) return 2 + names[0].length / 100;
      if (humps.startsWith(asked) && asked.length > 1) return 3;
      if (entry.word) return 9;
      if (names.some((name) => name.includes(asked))) return 4;
      return `${entry.doc} ${entry.group}`.toLowerCase().includes(asked) ? 5 : 9;
    };
    const later = (entry, order) => order + (entry.word && order > 0.5 && order < 9 ? 3.5 : 0); // it cannot be inserted
    return palette.map((entry) => [later(entry, rank(entry)), entry]).filter(([order]) => order < 9).sort(([a], [b]) => a - b).map(([, entry]) => entry);
  }
  /** What can be typed besides blocks: what it does, and how. rest: what follows the word. */
  const words = {
    input: ["an input of the diagram, as in input r=1 rad/s", (rest) => define("input", rest)],
    output: ["an output of the diagram: of the chosen signal", (rest) => define("output", rest)],
    parameter: ["a parameter of the diagram, as in parameter kp=20", (rest) => define("parameter", rest)],
    measure: ["what runs measure, as in measure peak of=motor.omega", (rest) => define("measure", rest)],
    log: ["record a signal in runs, the chosen one or as in log motor.omega", (rest) => log(rest)],
    describe: ["write what the selected block, or the diagram, is for", (rest) => describe(rest)],
    stop: ["when runs end, as in stop 10", (rest) => set("stop", rest)],
    every: ["how often runs record, as in every 0.01", (rest) => set("every", rest)],
    method: ["how runs integrate, as in method rk4", (rest) => set("method", rest)],
  };
  const set = async (name, text) => {
    const said = text || (await prompted(name));
    if (said) await entry(`run.${name}`, said);
  };
  const entry = (place, text) => act("define", { level: "", kind: "entry", text: `${place}=${text}` }, `${place.split(".").pop()} ${text}`);
  /** What is told of an entry: what it is, or, when parameters are typed, which it takes. */
  const told = (entry, text) => {
    const asked = text.trim().toLowerCase();
    const others = asked ? (entry.words ?? []).filter((one) => plain(one).startsWith(plain(asked)) && !plain(entry.type).startsWith(plain(asked))) : [];
    const also = others.length ? ` Simulink: ${others.join(", ")}.` : "";
    return text.includes(" ") && entry.takes ? entry.takes.join(" ") || "no parameters" : entry.doc + also;
  };
  /** Insert what is typed: a type with parameters, or an input, an output, a parameter. place: of a click, or of a wire. */
  app.insert = (text, event = null, wire = {}) => {
    const at = event ? pointer.near(app, event) : {};
    const shown = choose(app, {
      label: "Insert", placeholder: "pid kp=20, gain 3, input r, ...", text,
      find: (said, full) => {
        const [word, rest] = [said.split(/\s/, 1)[0], said.replace(/^\S*\s*/, "")];
        const defined = Object.entries(words).filter(([kind]) => word && kind.startsWith(word.toLowerCase())).map(([kind, [what, go]]) => ({ name: kind, told: what, go: () => go(rest) }));
        // Names of several words are known as well, as "dc motor".
        const whole = plain(rest) && !rest.includes("=") ? palette.filter((entry) => [title(entry), ...(entry.words ?? [])].some((one) => plain(one).includes(plain(said)))) : [];
        const shownOf = (entry, given) => ({
          name: title(entry), told: told(entry, given && full), picture: picture(entry), group: word ? "" : entry.group, why: entry.word ? entry.doc : "", go: () => add(entry, given, { ...at, ...wire }), drop: (dropped) => add(entry, given, pointer.near(app, dropped)),
        });
        const entries = [...whole.map((entry) => shownOf(entry, "")), ...meant(word).filter((entry) => !whole.includes(entry)).map((entry) => shownOf(entry, rest))].slice(0, word ? SHOWN : 999);
        return defined.some(({ name }) => name === word.toLowerCase()) ? [...defined, ...entries] : [...entries, ...defined];
      },
    });
    if (!palette.length) list().then(shown.refresh);
  };
  async function add({ type, diagram, fmu }, text, where) {
    const entry = Object.fromEntries(Object.entries({ type, diagram, fmu }).filter(([, value]) => value));
    const told = await act("insert", { entry, text, ...where });
    if (!told) return;
    pick(told.names);
    const faults = app.state.document.faults.filter(({ block }) => told.names.some((name) => block === app.drawing.full(name)));
    if (faults.length) app.announce(`${told.what}. ${faults.map(({ code, place, message }) => `${code} ${place}: ${message}`).join(" ")}`);
  }
  async function define(kind, text) {
    const source = kind === "output" ? chosenSource() : "";
    if (kind === "output" && !source && !text.includes("=")) return say("Choose the signal that the output gives first: its wire, or its block.");
    if (kind === "measure" && !text) return measure();
    const said = text || (await prompted({ input: "Input, as in r=1 rad/s", output: `Name of the output that gives ${source}`, parameter: "Parameter, as in kp=20 V" }[kind]));
    if (!said) return;
    await act("define", { kind, text: said, source });
  }
  /** Choose what is measured, and of which signal. */
  const measure = () => choose(app, {
    label: "Measure", placeholder: "Measure",
    find: (text) => Object.entries(measures).filter(([name]) => name.toLowerCase().includes(text.toLowerCase())).map(([name, what]) => ({ name, told: what, go: async () => {
      const said = await prompted("Measure, as in dip=peak of=motor.omega against=speed.y from=6", `${name} of=${app.state.wire ?? ""}`);
      if (said) await act("define", { level: "", kind: "measure", text: said });
    } })),
  });
  /** The signal on the open level that is chosen, or the first output of the chosen block. */
  const chosenSource = () => (app.state.wire && own(app.state.wire)) || [...picked].flatMap((name) => pointer.ports(app, name, "out"))[0]?.port || "";

  // --- wires by keys ------------------------------------------------------------------------------------------------

  /** Choose what a port, "in" or "out", is wired to. What is typed before the server has answered is kept. */
  app.connect = async (port, kind) => {
    const isSource = kind === "out";
    let entries = [];
    const shown = choose(app, { label: `Connect ${port} ${isSource ? "to" : "from"}`, placeholder: "Port", find: (text) => entries.filter(({ name }) => name.toLowerCase().includes(text.toLowerCase())).slice(0, SHOWN) });
    const told = await app.ask("targets", { end: port, kind, level: level() });
    if (!told) return shown.close();
    entries = Object.entries(told.ports).map(([name, why]) => ({ name, told: "", why, go: () => wire(...(isSource ? [port, name] : [name, port])) }));
    if (isSource) entries.push(...outputs().map((name) => ({ name, told: "output of the diagram", why: "", go: () => wire(port, name) })));
    entries.sort((a, b) => Boolean(a.why) - Boolean(b.why));
    shown.refresh();
  };
  const outputs = () => [...app.drawing.boxes()].filter(([, box]) => box.classList.contains("output")).map(([name]) => name);
  /** A wire from a source to an input, or to an output of the diagram; before: where its end was. */
  const wire = (source, sink, before = null) =>
    edit([...(before ? [{ unwire: before }] : []), sink.includes(".") ? { wire: source, to: sink } : { set: ["outputs", sink], to: source }], `wire ${source} to ${sink}`);
  function connect() {
    const [name] = picked;
    if (name === undefined) return say("Select a block first.");
    const driven = pointer.driven(app);
    const free = pointer.ports(app, name, "in").filter(({ port }) => !driven.has(port));
    const all = [...pointer.ports(app, name, "out").map(({ port }) => [port, "out"]), ...free.map(({ port }) => [port, "in"])];
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
    const sinks = !picked.size && app.state.wire ? (app.state.sink ? [app.state.sink] : [...pointer.driven(app)].filter(([, source]) => source === own(app.state.wire)).map(([sink]) => sink)) : [];
    const names = [...picked];
    if (!names.length && !sinks.length) return;
    const told = await act("delete", { names, sinks });
    if (told) pick([]);
  }
  function rename() {
    const [name] = picked;
    pointer.typedOver(app, name, async (to) => {
      const section = app.block(app.drawing.full(name)) ? "blocks" : app.drawing.boxes().get(name).classList.contains("input") ? "inputs" : "outputs";
      const isDone = await edit([{ rename: [section, name], to }], `rename ${name} to ${to}`);
      if (isDone) pick([to]);
      return isDone;
    });
  }
  async function log(signal) {
    const wire = signal || app.state.wire;
    if (!wire) return say("Choose a signal first: its wire, or its name in the list.");
    const { run } = await app.ask("panel", { path: "" });
    const at = run.log.indexOf(wire);
    const operation = at >= 0 ? { remove: ["run", "log", at], was: wire } : { add: ["run", "log"], value: wire };
    await act("edit", { level: "", operations: [operation], what: at >= 0 ? `log ${wire} no longer` : `log ${wire}` });
  }
  /** Write the doc of the selected block, or of the open level; with a name: of its parameter or input. */
  async function describe(text, name = blocks()[0] ?? "") {
    const told = text || (await app.ask("panel", { path: level() }));
    const row = !text && [...told.rows.Parameters ?? [], ...told.rows.Inputs ?? []].find((one) => one.name === name);
    const doc = text || row ? row?.doc : (name ? await app.ask("panel", { path: app.drawing.full(name) }) : told)?.own;
    const said = text || (await prompted(`What is ${name || app.state.document.name} for?`, doc ?? "", 5));
    if (typeof said === "string" && (text || said !== (doc ?? "").trim())) await act("describe", { of: name, text: said });
  }
  async function group() {
    const names = blocks();
    const as = await prompted("Name of the subdiagram", "group");
    if (as && (await edit([{ group: names, as }], `group ${names.join(", ")}`))) pick([as]);
  }
  async function arrange() {
    const names = picked.size > 1 ? [...picked] : [];
    if ((await act("arrange", { names })) && !names.length) app.drawing.fit();
  }
  const commands = {
    insert: { text: "Add", keys: "letters", what: "insert a block by its name, or drag it from the list; also a double click on free ground", go: () => app.insert(""), can: () => true },
    connect: { text: "Connect", keys: "Shift+C", what: "wire the selected block", go: connect, can: () => blocks().length > 0 },
    remove: { text: "Delete", keys: "Delete", what: "delete what is selected", go: remove, can: () => some() || app.state.wire !== null },
    rename: { text: "Rename", keys: "F2", what: "rename the selected block", go: rename, can: () => picked.size === 1 },
    duplicate: { text: "Duplicate", keys: "Ctrl+D", what: "duplicate what is selected", go: async () => pick((await act("duplicate", { names: [...picked] }))?.names ?? [...picked]), can: some },
    group: { text: "Group", keys: "Ctrl+G", what: "make a subdiagram of the selected blocks", go: group, can: () => blocks().length > 0 },
    ungroup: { text: "Ungroup", keys: "Ctrl+Shift+G", what: "put the blocks of a subdiagram in its place", go: () => edit([{ ungroup: [...picked][0] }], `ungroup ${[...picked][0]}`), can: () => app.block(app.state.selected)?.kind === "diagram" && picked.size === 1 },
    arrange: { text: "Lay out", keys: "Shift+L", what: "lay out the blocks that are selected, where these are several, or all", go: arrange, can: () => true },
    log: { text: "Log", keys: "", what: "record the selected signal in runs, or no longer", go: () => log(""), can: () => app.state.wire !== null },
    describe: { text: "Describe", keys: "", what: "write what the selected block, or the diagram, is for", go: () => describe(""), can: () => picked.size < 2 },
    undo: { text: "Undo", keys: "Ctrl+Z", what: "undo", go: () => act("undo"), can: () => Boolean(app.state.document?.editing?.undo) },
    redo: { text: "Redo", keys: "Ctrl+Y", what: "redo; also Ctrl+Shift+Z", go: () => act("redo"), can: () => Boolean(app.state.document?.editing?.redo) },
    open: { text: "Diagrams", keys: "", what: "open another diagram of the folder", go: () => others(), can: () => true },
  };
  async function others() {
    await list();
    const found = palette.filter(({ diagram }) => diagram);
    if (!found.length) return say("There is no other diagram in this folder.");
    const go = (diagram) => async () => {
      const tab = window.open("about:blank"); // now, while the click counts
      const told = await app.ask("tab", { file: diagram });
      if (told) tab ? (tab.location = told.url) : location.assign(told.url);
      else tab?.close();
    };
    choose(app, { label: "Open a diagram in a tab", placeholder: "Diagram", find: (text) => found.filter(({ diagram }) => diagram.includes(text)).map(({ diagram }) => ({ name: diagram, told: "", go: go(diagram) })) });
  }
  const hint = element("p", { class: "hint" }, "Type the name of a block, as in ", element("kbd", {}, "pid kp=20"), ", or double-click here. ", element("kbd", {}, "?"), " shows all keys.");
  const buttons = new Map();
  const refusal = element("output", { class: "refusal" });
  const bar = element("div", { id: "edits", role: "toolbar", "aria-label": "Edit", hidden: true });
  for (const [name, { text, keys, what, go }] of Object.entries(commands)) {
    buttons.set(name, element("button", { type: "button", class: ["ungroup", "log"].includes(name) ? "rare" : null, title: `${what[0].toUpperCase()}${what.slice(1)}${keys ? ` (${keys})` : ""}`, onclick: go }, text));
    bar.append(buttons.get(name));
  }
  bar.append(refusal);

  // --- keys ---------------------------------------------------------------------------------------------------------

  const shortcuts = (event) => {
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey) {
      if (key === "s") return "saved";
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
    else if (event.key === "Enter" && app.state.wire && !picked.size) app.openScope([app.state.wire]);
    else if (event.key === "Enter" && app.block(app.state.selected)?.kind !== "diagram") app.values();
    else if (/^[a-z]$/.test(event.key) && !isHeld && !event.altKey) app.insert(event.key);
    else return false;
    return true;
  };
  // What is pressed while nothing has the focus is meant for the drawing, and letters on its buttons are.
  document.addEventListener("keydown", (event) => {
    const isLetter = /^[a-z]$/.test(event.key) && !event.ctrlKey && !event.metaKey && !event.altKey;
    const isFree = event.target === document.body || (isLetter && event.target.closest("#drawing button"));
    if (bar.hidden || !isFree || document.querySelector("dialog")) return;
    app.drawing.view.focus();
    app.drawing.view.onkeydown(event);
  }, true);
  document.addEventListener("keydown", (event) => {
    if (bar.hidden || event.defaultPrevented || event.target.closest("input:not([type=range]), textarea, select, dialog")) return;
    const name = shortcuts(event);
    if (!name || (event.target.closest("#scopes, #analysis") && !["undo", "redo"].includes(name))) return;
    event.preventDefault();
    if (name === "saved") app.announce((refusal.textContent = `All is written in ${app.state.document.file} already.`));
    else if (commands[name].can()) commands[name].go();
  });
  /** To the values of what is selected, and back by Escape. */
  app.values = () => (isAwaited = true) && app.state.panel === app.state.selected && values();
  let isAwaited = false;
  const values = () => {
    if (isAwaited) document.querySelector("#panel .rows input, #panel .rows select")?.focus();
    isAwaited = false;
  };
  app.on("panel", values);
  document.getElementById("panel").addEventListener("keydown", ({ key }) => key === "Escape" && !bar.hidden && app.drawing.view.focus());
  document.addEventListener("paste", (event) => {
    if (bar.hidden || event.target.closest?.("input, textarea")) return;
    event.preventDefault();
    paste(event.clipboardData.getData("text/plain") || copied);
  });

  // --- values -------------------------------------------------------------------------------------------------------

  /** Write a parameter as typed. made: what shows it, and what is refused. */
  async function put(path, value, made) {
    const text = Array.isArray(value) ? value.map((one) => one && String(one)) : String(value);
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
  /** Write several, as [path, value], as one step. refused: what shows what is refused of a path. */
  async function putAll(values, refused) {
    try {
      const { later } = await app.connection.ask("put_all", { values: Object.fromEntries(values.map(([path, value]) => [path, String(value)])) });
      values.forEach(([path]) => refused(path).refuse());
      app.announce(`${values.map(([path, value]) => `${path} is ${value}`).join(", ")}${later ? `. Not in this run: ${later}` : ""}`);
    } catch (error) {
      refused(values[0][0]).refuse(error.message);
    }
  }
  const fields = new Map();
  /** The field of a parameter that no knob shows: an expression, or one of a diagram that has faults. */
  const field = (path, kind, { name, text, knob }) => {
    const isOwn = !app.block(path);
    if (!(kind === "Parameters" || (kind === "Inputs" && isOwn)) || (knob && !knob.bound)) return null;
    const full = path ? `${path}.${name}` : name;
    const now = text === "not wired" ? "" : text.replace(/^not wired: /, "");
    if (fields.has(full)) return fields.get(full)(now);
    const made = element("input", { type: "text", "aria-label": full, autocomplete: "off", spellcheck: "false" });
    give(made, now);
    const error = element("span", { class: "error", role: "alert" });
    made.refuse = (...words) => {
      error.replaceChildren(...words);
      made.ariaInvalid = words.length ? "true" : null;
    };
    let timer = 0;
    const take = () => {
      clearTimeout(timer);
      if (!isTyped(made)) return;
      settle(made);
      put(full, made.value, made);
    };
    made.oninput = () => {
      clearTimeout(timer);
      timer = setTimeout(take, TYPED);
    };
    made.onchange = take;
    const root = element("span", { class: "field" }, made, error);
    fields.set(full, (shown) => {
      if (!isTyped(made) && !made.ariaInvalid) give(made, shown); // what is typed stays
      return root;
    });
    return root;
  };
  const link = (text, label, onclick) => element("button", { class: "link", "aria-label": label, onclick }, text);
  /** What more can be done with a line of the panel: its wire, or the entry of the diagram itself. */
  const more = (path, kind, { name, link: source, text }) => {
    const at = path.split(".").slice(0, -1).join(".");
    const port = `${path.split(".").pop()}.${name}`;
    const isOpen = path === level();
    if (isOpen && ["Parameters", "Inputs", "Outputs"].includes(kind)) {
      const section = kind.toLowerCase();
      const renamed = async () => {
        const to = await prompted(`New name of ${name}`, name);
        if (to && to !== name) await edit([{ rename: [section, name], to }], `rename ${name} to ${to}`);
      };
      return [link("Rename", `Rename ${name}`, renamed), kind === "Outputs" ? null : link("Describe", `Describe ${name}`, () => describe("", name)),
        link("Delete", `Delete ${name}`, () => edit([{ remove: [section, name] }], `delete ${name}`))];
    }
    if (!path || at !== level() || !["Inputs", "Outputs"].includes(kind)) return [];
    if (kind === "Outputs") return [link("Connect", `Connect ${port}`, () => app.connect(port, "out"))];
    const isWired = source || !text.startsWith("not wired");
    return isWired ? [link("Take off", `Take the wire off ${port}`, () => act("delete", { names: [], sinks: [port] }))] : [link("Connect", `Connect ${port}`, () => app.connect(port, "in"))];
  };
  /** What the panel shows of the selected signal: where its wire begins and ends, its unit, its last value. */
  const signal = (name) => {
    const net = own(name);
    const { unit = "", shape = [] } = app.state.document.signals.find((one) => one.name === name) ?? {};
    const line = (what, ...shown) => element("li", {}, element("span", { class: "name" }, what), element("span", { class: "value" }, ...shown));
    const to = (port) => {
      const block = app.drawing.full(port.split(/[.[]/)[0]);
      return app.block(block) ? link(port, `Select ${block}`, () => app.reveal(block)) : port;
    };
    const sinks = [...pointer.driven(app)].filter(([, source]) => source === net).map(([sink]) => sink);
    const ends = sinks.map((sink) => line("to", to(sink), link("Take off", `Take the wire off ${sink}`, () => act("delete", { names: [], sinks: [sink] }))));
    return [
      element("header", {}, element("h2", {}, name), element("p", { class: "type" }, shape.length ? `signal of ${shape.join("×")}` : "signal"), element("button", { onclick: () => app.openScope([name]) }, "Scope")),
      element("ul", { class: "rows" }, line("from", to(net || name)), ...ends, unit ? line("unit", unit) : null, line("last value", element("output", {}))),
      sinks.length || net.split(".").length > 2 ? null : element("p", { class: "note" }, "It is wired to nothing here."),
    ];
  };
  let areRunsOpen = false;
  /** What a diagram says beside its blocks: what is logged, measured, and when a run ends. */
  const forms = (panel, selected) => {
    if (selected || !panel.run) return null;
    const line = (name, text, ...more) => element("li", {}, element("span", { class: "name" }, name), element("span", { class: "value" }, text, " ", ...more));
    const gone = (place, what, was) => element("button", { class: "link", "aria-label": `Delete ${what}`, onclick: () => edit([{ remove: place, ...was }], `delete ${what}`) }, "Delete");
    const change = (place, what, text) => element("button", { class: "link", "aria-label": `Change ${what}`, onclick: async () => {
      const said = await prompted(what, text);
      if (said && said !== text) await act("define", place === "measure" ? { kind: place, text: said } : { kind: "entry", text: `${place}=${said}` });
    } }, "Change");
    const log = panel.run.log.map((name, index) => line(name, "logged", gone(["run", "log", index], name, { was: name })));
    return element("details", { class: "doc", open: areRunsOpen, ontoggle: ({ target }) => (areRunsOpen = target.open) }, element("summary", {}, element("h3", {}, "Runs, log and measures")),
      element("ul", { class: "rows" },
        ...["stop", "every", "method"].map((name) => line(name, panel.run[name], change(`run.${name}`, name, panel.run[name]))),
        ...log, ...Object.entries(panel.run.measures).map(([name, text]) => line(name, text, change("measure", name, `${name}=${text}`), gone(["measures", name], name)))),
      element("button", { onclick: measure }, "Add a measure"));
  };
  /** The buttons below a fault that do what its cure says. */
  const remedy = ({ remedies = [] }) => remedies.length ? element("div", { class: "remedies" }, ...remedies.map(({ label, sink, ...told }) => element("button", { onclick: (event) => {
    event.stopPropagation();
    return sink ? connectAt(sink) : act("edit", { ...told, what: label });
  } }, label))) : null;
  async function connectAt(sink) {
    const at = sink.split(".").slice(0, -2).join(".");
    if (at !== level()) await app.open(at);
    app.connect(sink.split(".").slice(-2).join("."), "in");
  }

  let seen = -1;
  app.on("document", (told) => {
    // With something to redo it is what an undo led back to.
    if (/ on disk$/.test(told.editing?.undo) && !told.editing.redo && seen >= 0 && told.revision !== seen) say(`${told.file} was changed by another program: undo takes it back.`);
    seen = told.revision;
    if (!told.editing || !bar.hidden) return mark();
    bar.hidden = false;
    document.getElementById("drawing").prepend(bar);
    document.body.classList.add("edits");
    pointer.start(app, { picked, pick, act, say, wire });
    list();
    app.drawing.view.append(hint);
    if (document.activeElement === document.body) app.drawing.view.focus();
    Object.assign(app, { key, put, putAll, field, more, forms, remedy, signal, entry, many: () => [...picked], chosen: (path, name) => ["edit", { level: path.split(".").slice(0, -1).join("."), operations: [name === "base" ? { remove: ["blocks", path.split(".").pop(), "variant"] } : { set: ["blocks", path.split(".").pop(), "variant"], to: name }], what: `variant ${name}` }] });
    for (const one of app.keys) one[0] = one[0].replace(/^[a-z](?= |$)/i, (letter) => `Shift+${letter.toUpperCase()}`); // letters insert
    for (const { keys, what } of Object.values(commands)) if (keys) app.keys.push([keys, what]);
    app.keys.push(["Ctrl+C Ctrl+X Ctrl+V", "copy, cut and paste, also as text"], ["Ctrl+arrow", "along a wire to the next block"], ["arrows", "move what is selected; without a selection, the drawing"], ["Enter", "to the values of the selected block; Escape leads back; of a selected wire: its scope"]);
    mark();
  });
}
