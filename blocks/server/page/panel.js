/** The panel: what the selected block is, its parameters, its ports; without one, the diagram itself. */
import { element, shown, trusted } from "./elements.js";

export function start(app) {
  const place = document.getElementById("panel");
  const link = (path, text) => element("button", { class: "link", onclick: () => app.reveal(path) }, text);
  const unit = (text) => (text ? element("span", { class: "unit" }, text) : null);

  const section = (title, rows) =>
    rows.length ? [element("h3", {}, title), element("ul", { class: "rows" }, ...rows)] : [];

  const parameter = (row) => {
    const isBound = row.text.startsWith("=");
    const isOther = row.text && !isBound && row.default && row.default !== row.text && Number(row.default) !== row.value;
    const notes = [row.why && !isBound && `not in a run: ${row.why}`, isOther && `default ${row.default}`].filter(Boolean);
    const value = row.value === null || isBound ? row.text || row.default : shown(row.value);
    return element(
      "li", { class: `parameter${row.tunable ? " tunable" : ""}`, "data-name": row.path },
      element("span", { class: "name" }, row.name),
      element("span", { class: "value", title: row.why || null }, value, unit(row.value === null || isBound ? "" : row.unit)),
      element("span", { class: "what" }, row.doc, isBound && row.value !== null ? element("b", {}, ` ${shown(row.value)} ${row.unit}`) : null),
      notes.length ? element("span", { class: "notes" }, notes.join("; ")) : null,
    );
  };

  const free = ({ default: value }) => (value === null || value === "" ? "not wired" : `not wired: ${shown(value)}`);
  const input = (row) =>
    element(
      "li", {}, element("span", { class: "name" }, row.name),
      element("span", { class: "value" }, row.from ? link(row.from, row.source) : row.source || free(row), unit(row.unit)),
      row.doc ? element("span", { class: "what" }, row.doc) : null,
    );

  const output = (row) => {
    const isSignal = app.state.document.signals.some((one) => one.name === row.signal);
    const open = () => app.openScope([row.signal]);
    return element(
      "li", {}, element("span", { class: "name" }, row.name),
      element("span", { class: "value" }, isSignal ? element("button", { class: "link", title: `Show ${row.signal} in a scope`, onclick: open }, "scope") : null, unit(row.unit)),
      row.doc ? element("span", { class: "what" }, row.doc) : null,
    );
  };

  const fault = (one) =>
    element("li", { class: one.warning ? "warning" : "fault" }, element("b", {}, one.code), ` ${one.place}: ${one.message} ${one.cure}`);

  let asked = 0;
  const show = async (path) => {
    const number = ++asked;
    const panel = await app.ask("panel", { path: path ?? "" });
    if (!panel || number !== asked) return;
    const name = path?.split(".").pop() ?? app.state.document.name;
    const kind = { diagram: path ? "subdiagram" : "diagram", fmu: "FMU", block: "block" }[panel.kind];
    const open = path && panel.kind === "diagram" ? element("button", { onclick: () => app.open(path) }, "Open") : null;
    const hasFocus = place.contains(document.activeElement);
    place.replaceChildren(
      element("header", {}, element("h2", {}, name), element("p", { class: "type" }, panel.type === name ? kind : `${panel.type} · ${kind}`), open),
      element("div", { class: "doc" }, ...trusted(panel.mathml)),
      ...(panel.faults.length ? [element("ul", { class: "faults" }, ...panel.faults.map(fault))] : []),
      ...(panel.doc ? [element("p", { class: "own" }, panel.doc)] : []),
      ...panel.notes.map((note) => element("p", { class: "note" }, note)),
      ...section("Parameters", panel.parameters.map(parameter)),
      ...section("Inputs", panel.inputs.map(input)),
      ...section("Outputs", panel.outputs.map(output)),
      ...section("Memory", panel.states.map((row) =>
        element("li", {}, element("span", { class: "name" }, row.name), element("span", { class: "value" }, row.kind, unit(row.unit)), element("span", { class: "what" }, row.doc)))),
      ...(panel.more ? [element("details", { class: "doc" }, element("summary", {}, element("h3", {}, "More")), ...trusted(panel.more))] : []),
    );
    if (hasFocus) place.focus();
    app.emit("panel", { panel, place });
  };
  app.on("select", show);
  app.on("document", () => show(app.state.selected));
}
