/** The panel: what the selected block is, its parameters, its ports; without one, the open diagram. */
import { element, fault, shown, trusted } from "./elements.js";

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

  let asked = 0;
  const show = async (selected) => {
    const number = ++asked;
    const path = selected ?? app.state.level;
    const panel = await app.ask("panel", { path });
    if (!panel || number !== asked) return;
    const name = path.split(".").pop() || app.state.document.name;
    const kind = { diagram: path ? "subdiagram" : "diagram", fmu: "FMU", block: "block" }[panel.kind];
    const open = selected && panel.kind === "diagram" ? element("button", { onclick: () => app.open(path) }, "Open") : null;
    const focused = place.contains(document.activeElement) ? document.activeElement : null;
    const parts = [
      element("header", {}, element("h2", {}, name), element("p", { class: "type" }, panel.type === name ? kind : `${panel.type} · ${kind}`), open),
      variants(panel),
      element("div", { class: "doc" }, ...trusted(panel.mathml)),
      panel.faults.length ? element("div", { class: "faults" }, ...panel.faults.map((one) => element("div", {}, fault(one), app.remedy?.(one) ?? null))) : null,
      app.forms?.(panel, selected) ?? null,
      panel.doc ? element("p", { class: "own" }, panel.doc) : null,
      ...panel.notes.map((note) => element("p", { class: "note" }, note)),
      ...Object.entries(panel.rows).filter(([, rows]) => rows.length).flatMap(([title, rows]) => [element("h3", {}, title), element("ul", { class: "rows" }, ...rows.map(row(path, title, panel.faults)))]),
      panel.more ? element("details", { class: "doc" }, element("summary", {}, element("h3", {}, "More")), ...trusted(panel.more)) : null,
    ];
    place.replaceChildren(...parts.filter(Boolean));
    if (focused) (focused.isConnected ? focused : place).focus();
    app.state.panel = selected;
    app.emit("panel", panel);
  };
  app.on("select", show);
  app.on("level", () => app.state.selected ?? show(null));
  app.on("document", () => show(app.state.selected));
}
