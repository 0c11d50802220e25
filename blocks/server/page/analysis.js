/** Looking deeper: loops and their margins, responses, modes, limit cycles, bands of sweeps; blocks colored by rate. */
import { element, fault, shown, table } from "./elements.js";
import { mapOf } from "./map.js";

const AT = { at: ["Where it is linearized", [["start", "at the start"], ["cursor", "at the cursor"], ["rest", "where it rests"]]] };
/** By view: its name, what the server is asked, its fields with their labels, those that must be filled, and what it needs. */
const VIEWS = {
  loop: { label: "Loop", ask: "response", fields: { input: ["opened at", "signals"], ...AT }, must: ["input"],
    hint: "Click a wire of a loop, or name its signal: the loop is opened there." },
  response: { label: "Response", ask: "response", fields: { input: ["from", "signals"], output: ["to", "signals"], ...AT }, must: ["input", "output"],
    hint: "Name the signal where a change is put in, and the one that is looked at." },
  map: { label: "Map", ask: "loop_map", must: [], hint: "Computing ...",
    fields: { control: ["loop at", "signals"], output: ["of", "signals"], x: ["over", "gains"], x0: ["from", "number"], x1: ["to", "number"], y: ["and", "gains"], y0: ["from", "number"], y1: ["to", "number"] } },
  modes: { label: "Modes", ask: "modes", fields: AT, must: [] },
  cycles: { label: "Limit cycles", ask: "cycles", fields: { at: [AT.at[0], AT.at[1].toReversed()] }, must: [] },
  band: { label: "Band", ask: "band", must: ["signal"],
    fields: { signal: ["of", "signals"], parameter: ["vary", "parameters"], low: ["from", "number"], high: ["to", "number"], n: ["runs", "number"], file: ["or a saved sweep", "text"] },
    hint: "Runs of the diagram with a parameter between two values; 5, 50 and 95 % of them are drawn over the scopes." },
};

const LATE = 500; // ms after which a question can be cancelled

/** @param {any} app */
export function start(app) {
  const place = document.getElementById("analysis");
  let [what, cursor] = ["loop", null];
  const amplitudes = new Map(); // by the signal of a law
  const lists = { signals: element("datalist", { id: "analysis-signals" }), parameters: element("datalist", { id: "analysis-parameters" }), gains: element("datalist", { id: "analysis-gains" }) };
  const body = element("div", { class: "analysis-body", "aria-busy": "false" });

  // --- a form for each view ---
  function field(name, label, kind) {
    const named = { name, "aria-label": label, onchange: () => what === "band" || ask() };
    const made = Array.isArray(kind) ? element("select", named, ...kind.map(([value, text]) => element("option", { value }, text)))
      : kind === "number" ? element("input", { ...named, type: "number", step: "any", class: "short" })
        : element("input", { ...named, list: `analysis-${kind}`, size: 14, spellcheck: "false" });
    return element("label", {}, Array.isArray(kind) ? "" : `${label} `, made);
  }
  const forms = Object.fromEntries(Object.entries(VIEWS).map(([key, { fields }]) => {
    const onsubmit = (event) => [event.preventDefault(), ask()];
    const submit = key === "band" ? [element("button", {}, "Show the band"), element("button", { type: "button", onclick: () => remove() }, "Remove")] : [];
    return [key, element("form", { class: "fields", onsubmit }, ...Object.entries(fields).map(([name, [label, kind]]) => field(name, label, kind)), ...submit)];
  }));
  const tabs = Object.entries(VIEWS).map(([key, { label }]) => element("button", { "aria-pressed": "false", onclick: () => turn(key), "data-what": key }, label));
  const close = element("button", { onclick: () => show(false), title: "Close (B)" }, "Close");
  const cancel = element("button", { hidden: true, onclick: () => app.connection.cancel(under) }, "Cancel");
  place.append(element("header", { class: "bar" }, element("h2", {}, "Analysis"), element("span", { class: "tabs", role: "group", "aria-label": "What is shown" }, ...tabs), ...Object.values(forms), cancel, close), body, ...Object.values(lists));

  const map = mapOf(app, forms.map, () => ask());
  const isAtCursor = () => forms[what].elements.at?.value === "cursor";
  function given() {
    if (what === "map") return { ...map.given(), amplitude: Object.fromEntries(amplitudes) };
    const fields = Object.fromEntries([...forms[what].elements].filter((one) => one.value && one.name).map((one) => [one.name, one.type === "number" ? one.valueAsNumber : one.value]));
    if (VIEWS[what].must.some((name) => !(name in fields))) return null;
    if (isAtCursor()) fields.at = cursor ?? (app.state.run?.id ? app.state.run.t : "start");
    return ["band", "cycles"].includes(what) ? fields : { ...fields, amplitude: Object.fromEntries(amplitudes) };
  }

  // --- asking: one question at a time, and the last one counts ---
  let [isAsked, next, under] = [false, null, null];
  async function ask() {
    if (place.hidden || (what === "map" && map.isHeld)) return;
    const fields = given();
    next = fields && { view: what, fields };
    if (!fields || what === "band") body.replaceChildren(element("p", { class: "hint" }, fields ? "Running ..." : VIEWS[what].hint));
    if (isAsked) return void (what === "map" && app.connection.cancel(under));
    isAsked = true;
    body.setAttribute("aria-busy", "true");
    while (next) {
      const { view, fields: asked } = next;
      next = null;
      under = app.connection.ask(VIEWS[view].ask, asked);
      const late = setTimeout(() => (cancel.hidden = false), LATE);
      const answer = await under.catch((error) => ({ title: "", laws: [], faults: error.faults ?? [{ code: "", place: "", message: error.message, cure: "" }] }));
      clearTimeout(late);
      cancel.hidden = true;
      if (!next && view === what && given()) fill(answer);
    }
    isAsked = false;
    body.setAttribute("aria-busy", "false");
  }

  // --- what comes back ---
  /** A slider for each law that bends, over the orders of magnitude around 1. */
  function slider({ signal, laws, rough, value: stands }) {
    const on = element("input", { type: "checkbox" });
    const made = element("input", { type: "range", min: -5, max: 3, step: 0.05, "aria-label": `Amplitude of ${signal}` });
    const number = element("output");
    const tell = () => {
      made.disabled = !on.checked;
      number.textContent = on.checked ? shown(amplitudes.get(signal), 4) : "off";
      made.setAttribute("aria-valuetext", number.textContent);
    };
    on.checked = amplitudes.has(signal);
    made.value = String(Math.log10(amplitudes.get(signal) ?? 0.1));
    on.onchange = made.oninput = () => {
      if (on.checked) amplitudes.set(signal, Number((10 ** Number(made.value)).toPrecision(3)));
      else amplitudes.delete(signal);
      tell();
      ask();
    };
    tell();
    const title = `${laws.join(", ")}: ${rough ? "no slope where it stands, at" : "off: its slope where it stands, at"} ${shown(stands, 4)}`;
    return element("div", { class: "law", title }, element("label", {}, on, ` sine at ${signal}`), made, number, rough ? element("b", { class: "unit" }, "no slope") : null);
  }
  /** Words on a point of the curve, which moves by the arrow keys. */
  function reading([omega, decibel, degrees]) {
    const words = element("output");
    const at = element("input", { type: "range", min: 0, max: omega.length - 1, "aria-label": "Read out the curve" });
    at.oninput = () => {
      words.textContent = `${shown(omega[at.value], 4)} rad/s: ${shown(decibel[at.value], 4)} dB, ${shown(degrees[at.value], 4)}°`;
      at.setAttribute("aria-valuetext", words.textContent);
    };
    at.oninput();
    return element("p", { class: "law" }, at, words);
  }
  function fill(answer) {
    const { title, laws, faults, figures = [], curve, head = [], rows = [], notes = [], more = [], band } = answer;
    if (answer.map) {
      map.show(answer);
      options(lists.gains, answer.map.names);
    }
    const key = laws.map((law) => law.signal).join();
    let sliders = body.querySelector(".laws"); // which stay as they are while one is moved
    if (sliders?.dataset.key !== key) sliders = element("div", { class: "laws", "data-key": key }, ...laws.slice(0, 8).map(slider));
    const known = body.querySelectorAll("img"); // shown until the next ones are read
    const pictures = figures.map((svg, k) => {
      const made = known[k] ?? element("img");
      return Object.assign(made, { src: `data:image/svg+xml,${encodeURIComponent(svg)}`, alt: `${k ? "Nyquist curve" : "Bode plot"}. ${title}` });
    });
    const cells = rows.map((row) => row.map((cell) => (typeof cell === "number" ? shown(cell, 5) : cell ?? "-")));
    const numbers = element("div", { class: "numbers" },
      element("p", {}, title), ...faults.map(fault), rows.length ? table(head, cells) : null, curve ? reading(curve) : null,
      ...notes.map((note) => element("p", { class: "hint" }, note)),
      more.length ? element("details", {}, element("summary", {}, "Poles, zeros and blocks"), element("pre", {}, more.join("\n"))) : null);
    if (answer.map && map.root.isConnected && sliders.isConnected) return body.querySelector(".numbers").replaceWith(numbers); // it keeps the focus and the pointer
    const result = element("div", { class: "result" }, ...(answer.map ? [map.root] : pictures), numbers);
    if (sliders.isConnected) body.querySelector(".result").replaceWith(result);
    else body.replaceChildren(sliders, result);
    if (band) {
      app.openScope(Object.keys(band.signals));
      app.showBand(band);
    }
    app.announce([title, ...faults.map((one) => one.message), ...notes, ...(head.length ? [] : cells.slice(0, 4).map((row) => row.join(": ")))].join(" "));
  }
  function remove() {
    app.showBand(null);
    app.announce("The band is gone.");
  }

  // --- the pane ---
  function turn(to) {
    what = to;
    tabs.forEach((tab) => tab.setAttribute("aria-pressed", String(tab.dataset.what === what)));
    Object.entries(forms).forEach(([key, form]) => (form.hidden = key !== what));
    body.replaceChildren(element("p", { class: "hint" }, VIEWS[what].hint ?? ""));
    if (what !== "band") ask();
  }
  function show(isOpen) {
    place.hidden = !isOpen;
    if (!isOpen && isAsked) [next] = [null, app.connection.cancel(under)];
    opener.setAttribute("aria-expanded", String(isOpen));
    if (!isOpen) return opener.focus();
    turn(what);
    tabs.find((tab) => tab.dataset.what === what).focus();
  }
  const opener = element("button", { title: "Bode, Nyquist, margins, maps, modes, limit cycles, bands (B)", "aria-expanded": "false", "aria-controls": "analysis", onclick: () => show(place.hidden) }, "Analysis");
  app.keys?.push(["B", "analysis of the selected wire: Bode, Nyquist, margins; again: close"]);
  document.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "b" || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, textarea, select, dialog")) return;
    event.preventDefault();
    show(place.hidden);
  });
  const anew = () => what !== "band" && ask();
  app.on("wire", (name) => {
    if (!name) return;
    forms.loop.elements.input.value = forms.band.elements.signal.value = name;
    if (what === "loop") ask();
  });
  const options = (list, names) => list.replaceChildren(...names.map((value) => element("option", { value })));
  app.on("panel", ({ rows }) => options(lists.parameters, (rows.Parameters ?? []).filter(({ knob }) => knob).map(({ knob }) => knob.name)));
  app.on("document", ({ signals }) => {
    options(lists.signals, signals.map((one) => one.name));
    anew();
  });
  app.on("knob", anew);
  let state = "";
  app.on("run", (run) => {
    if (run.state !== "running" && run.state !== state && isAtCursor()) ask();
    state = run.state;
  });
  app.on("cursor", (t) => {
    cursor = t;
    if (isAtCursor()) ask();
  });

  // --- blocks colored, each with its number in the legend ---
  const legend = element("div", { id: "color-legend", hidden: true });
  const by = element("select", { "aria-label": "Color of blocks", onchange: () => colorBy() }, ...[["", "no colors"], ["rate", "by rate"], ["rejected", "by rejected steps"]].map(([value, text]) => element("option", { value }, text)));
  let colored = null;
  async function colorBy() {
    colored = by.value ? await app.ask("color", { by: by.value }) : null;
    if (!colored) by.value = "";
    paint();
    if (colored) app.announce(legend.textContent);
  }
  function paint() {
    document.querySelectorAll("#drawing .color-number").forEach((one) => one.remove());
    document.querySelectorAll("#drawing [data-color]").forEach((one) => one.removeAttribute("data-color"));
    legend.hidden = !colored;
    if (!colored) return;
    const most = Math.max(1, ...Object.values(colored.blocks).filter(Number.isFinite));
    const group = (value) => (typeof value === "number" ? (value ? 1 + Math.min(3, Math.floor((4 * value) / most)) : 0) : colored.legend.indexOf(value));
    const prefix = app.state.level ? `${app.state.level}.` : "";
    for (const box of document.querySelectorAll("#drawing g[data-path]:not(.frame)")) {
      const value = colored.blocks[prefix + box.dataset.path];
      const face = box.querySelector(".face");
      if (value === undefined || !face) continue;
      box.dataset.color = String(group(value) % 6);
      const { x, y } = face.getBBox();
      const label = document.createElementNS("http://www.w3.org/2000/svg", "text");
      Object.entries({ class: "color-number", x: x + 3, y: y + 10 }).forEach(([key, number]) => label.setAttribute(key, number));
      label.textContent = typeof value === "number" ? String(value) : String(group(value) + 1);
      face.parentNode.append(label);
    }
    const items = colored.legend.length ? colored.legend.map((words, k) => [k % 6, `${k + 1}: ${words}`]) : [[0, "no step rejected for it"], [1, "few"], [4, `many (most: ${most})`]];
    legend.replaceChildren(...items.map(([k, words]) => element("span", { class: "key", "data-color": k }, words)));
  }
  app.on("drawn", paint);
  app.on("run", (run) => by.value === "rejected" && run.state !== "running" && colorBy());
  document.querySelector("#drawing .tools")?.prepend(by, opener);
  document.getElementById("drawing").append(legend);
}
