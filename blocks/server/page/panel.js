/** The panel: what the selected block is, its parameters, its ports; without one, the open diagram. */
import { anew, element, fault, fill, isTyped, keeper, shown, trusted } from "./elements.js";

export function start(app) {
  const place = document.getElementById("panel");
  const link = (text, onclick, attributes = {}) => element("button", { class: "link", onclick, ...attributes }, text);
  const span = (name, ...children) => element("span", { class: name }, ...children);

  const row = (path, title, faults) => ({ name, doc, unit, text, note, knob, link: to, signal }) => {
    const known = app.state.document.signals.find((one) => one.name === signal);
    const field = app.field?.(path, title, { name, text, knob });
    const value = [
      ...(field ? [field] : knob ? [app.knob?.(knob) ?? `${knob.text}${knob.bound ? ` = ${shown(knob.value)} ${knob.unit}` : ""}`] : [to ? link(text, () => app.reveal(to)) : text]),
      known ? link("scope", () => app.openScope([signal]), { title: `Show ${signal} in a scope` }) : null,
      knob ? null : span("unit", unit || known?.unit || ""),
      ...(app.more?.(path, title, { name, link: to, text }) ?? []),
    ];
    const told = [doc, knob?.range].filter(Boolean).join(", ");
    const notes = [note, knob?.why && !knob.bound && `not in a run: ${knob.why}`].filter(Boolean).join("; ");
    return element("li", {}, span("name", name), span("value", ...value.filter(Boolean)), told ? span("what", told) : null, notes ? span("notes", notes) : null,
      ...faults.filter((one) => one.place === (path ? `${path}.${name}` : name)).map((one) => element("span", { class: "error", role: "note" }, `${one.code} ${one.message} ${one.cure}`)));
  };

  function variants({ path, variants: choices, variant, anew }) {
    if (!app.knob || !choices.length) return null;
    const choice = element("select", { onchange: () => app.ask(...(app.chosen?.(path, choice.value) ?? ["variant", { path, name: choice.value }])) }, ...choices.map((one) => element("option", { selected: one === variant }, one)));
    const offer = element("button", { hidden: !anew, onclick: () => app.begin() }, `Run anew with ${path} = ${variant}`);
    return element("p", {}, element("label", {}, "Variant ", choice), " ", offer);
  }

  /** What is shown of several blocks. */
  const several = () => {
    const names = app.many?.() ?? [];
    if (names.length < 2) return null;
    const one = (name) => element("li", {}, link(name, () => app.reveal(app.drawing.full(name))));
    return [element("header", {}, element("h2", {}, `${names.length} selected`)), element("ul", { class: "rows" }, ...names.map(one))];
  };
  /** What is shown of a signal whose wire is selected on the open level. */
  const wired = () => {
    const { wire, level } = app.state;
    return wire && app.signal && wire.startsWith(level ? `${level}.` : "") ? app.signal(wire) : null;
  };
  const only = (shown) => {
    const hadFocus = place.contains(document.activeElement);
    fill(place, shown.filter(Boolean));
    if (hadFocus && !place.contains(document.activeElement)) place.focus();
    tell();
  };
  let values = {};
  const tell = () => {
    const last = app.state.wire && place.querySelector(":scope > .rows output");
    if (last) last.textContent = [values[app.state.wire] ?? "none yet: run"].flat().slice(0, 8).map((x) => (typeof x === "number" ? shown(x) : x)).join(", ");
  };
  app.on("values", (now) => {
    values = now;
    tell();
  });
  let asked = 0;
  const show = async (selected) => {
    const number = ++asked;
    const special = selected === null || app.many?.().length > 1 ? several() ?? wired() : null;
    if (special) return anew("panel", () => number === asked && only(special));
    const path = selected ?? app.state.level;
    const panel = await app.ask("panel", { path });
    if (!panel || number !== asked) return;
    const name = path.split(".").pop() || app.state.document.name;
    const kind = { diagram: path ? "subdiagram" : "diagram", fmu: "FMU", block: "block" }[panel.kind];
    const open = selected && panel.kind === "diagram" ? element("button", { onclick: () => app.open(path) }, "Open") : null;
    anew("panel", () => number === asked && put(selected, path, panel, element("header", {}, element("h2", {}, name), element("p", { class: "type" }, panel.type === name ? kind : `${panel.type} · ${kind}`), open)));
  };
  /** What is the same as before stays the same element: with its focus, its caret, what is open in it. */
  const keep = keeper();
  const put = (selected, path, panel, header) => {
    const focused = place.contains(document.activeElement) ? document.activeElement : null;
    const typed = focused && (isTyped(focused) || focused.ariaInvalid) ? focused.value : null; // a browser takes it when its field goes
    const here = [path, app.state.level, selected];
    const known = (name) => app.state.document.signals.find((one) => one.name === name);
    const rows = ([title, entries]) => {
      const list = keep([here, title, "rows"], () => element("ul", { class: "rows" }));
      fill(list, entries.map((one) => {
        const faults = panel.faults.filter(({ place: of }) => of === (path ? `${path}.${one.name}` : one.name));
        return keep([here, title, one, faults, known(one.signal)], () => row(path, title, faults)(one));
      }));
      return [keep([title], () => element("h3", {}, title)), list];
    };
    fill(place, [
      header,
      keep([here, panel.variants, panel.variant, panel.anew], () => variants(panel) ?? ""),
      keep([panel.mathml], () => element("div", { class: "doc" }, ...trusted(panel.mathml))),
      panel.faults.length ? keep([here, panel.faults], () => element("div", { class: "faults" }, ...panel.faults.map((one) => element("div", {}, fault(one), app.remedy?.(one) ?? null)))) : null,
      keep([here, panel.run], () => app.forms?.(panel, selected) ?? ""),
      panel.doc ? element("p", { class: "own" }, panel.doc) : null,
      ...panel.notes.map((note) => element("p", { class: "note" }, note)),
      ...Object.entries(panel.rows).filter(([, entries]) => entries.length).flatMap(rows),
      panel.more ? keep([panel.more], () => element("details", { class: "doc" }, element("summary", {}, element("h3", {}, "More")), ...trusted(panel.more))) : null,
    ].filter(Boolean));
    keep.round();
    if (focused && document.activeElement !== focused) again(focused, typed).focus();
    app.state.panel = selected;
    app.emit("panel", panel);
  };
  /** What stands for an element that had the focus: itself, or its like, with what was typed and is not taken yet. */
  function again(focused, typed) {
    if (focused.isConnected) return focused;
    const like = focused.ariaLabel ? [...place.querySelectorAll(focused.localName)].find((one) => one.ariaLabel === focused.ariaLabel) : null;
    if (like?.type === "text" && typed !== null) {
      like.value = typed;
      like.dispatchEvent(new Event("input"));
    }
    return like ?? place;
  }
  app.on("select", show);
  app.on("wire", (name) => name && app.signal && show(app.state.selected));
  app.on("level", () => app.state.selected ?? show(null));
  app.on("document", () => show(app.state.selected));
}
