/** Looking deeper: loops and their margins, responses, modes, limit cycles, bands of sweeps; blocks colored by rate. */
import { chart, short } from "./charts.js";
import { element } from "./elements.js";

const WHATS = { loop: "Loop", response: "Response", modes: "Modes", cycles: "Limit cycles", band: "Band" };
const field = (label, input) => element("label", {}, `${label} `, input);
const table = (caption, head, rows) =>
  element("table", {}, element("caption", {}, caption),
    head.length ? element("thead", {}, element("tr", {}, ...head.map((text) => element("th", { scope: "col" }, text)))) : null,
    element("tbody", {}, ...rows.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, first), ...rest.map((text) => element("td", {}, text))))));
const complex = ([re, im]) => (im ? `${short(re)} ± ${short(im)}j` : short(re));
const faultsOf = (faults) => faults.map((one) => element("p", { class: "fault" }, element("b", {}, one.code), ` ${one.place}: ${one.message} ${one.cure}`));

/** @param {any} app */
export function start(app) {
  const place = document.getElementById("analysis");
  let what = "loop";
  let cursor = null;
  const amplitudes = new Map(); // by the signal of a law
  const signals = element("datalist", { id: "analysis-signals" });
  const text = (label, attributes = {}) => element("input", { list: "analysis-signals", size: 15, "aria-label": label, spellcheck: "false", onchange: () => ask(), ...attributes });
  const [signal, input, output] = [text("Loop opened at"), text("From"), text("To")];
  const points = { start: "at the start", cursor: "at the cursor", rest: "where it rests" };
  const choice = (...keys) => element("select", { "aria-label": "Where it is linearized", onchange: () => ask() }, ...keys.map((key) => element("option", { value: key }, points[key])));
  const [when, around] = [choice("start", "cursor"), choice("rest", "start", "cursor")]; // a limit cycle goes around a point of rest
  const tabs = Object.entries(WHATS).map(([key, label]) => element("button", { "aria-pressed": "false", onclick: () => turn(key), "data-what": key }, label));
  const fields = element("span", { class: "fields" });
  const body = element("div", { class: "analysis-body", "aria-busy": "false" });
  const close = element("button", { onclick: () => show(false), title: "Close (B)" }, "Close");
  place.append(element("header", { class: "bar" }, element("h2", {}, "Analysis"), element("span", { class: "tabs", role: "group", "aria-label": "What is shown" }, ...tabs), fields, close), body, signals);

  // --- asking: one question at a time, and the last one counts ---
  let isAsked = false;
  let next = null;
  async function later(name, given, then) {
    next = { name, given, then };
    if (isAsked) return;
    isAsked = true;
    body.setAttribute("aria-busy", "true");
    while (next) {
      const { name: asked, given: with_, then: take } = next;
      next = null;
      const answer = await app.connection.ask(asked, with_).catch((error) => ({ faults: error.faults ?? [{ code: "", place: "", message: error.message, cure: "" }] }));
      if (next) continue;
      const failed = answer.is ? null : answer.faults;
      if (failed) body.replaceChildren(...faultsOf(failed));
      else take(answer);
      const said = failed ? failed.map((one) => `${one.place}: ${one.message}`).join(" ") : body.dataset.said;
      if (said) app.announce(said);
    }
    isAsked = false;
    body.setAttribute("aria-busy", "false");
  }
  const isAtCursor = () => (what === "cycles" ? around : when).value === "cursor" && what !== "band";
  const point = () => {
    const t = cursor ?? (app.state.run?.id ? app.state.run.t : null);
    return isAtCursor() && t !== null ? { t } : {};
  };
  const bent = () => ({ amplitude: Object.fromEntries(amplitudes) });
  const hint = (words) => body.replaceChildren(element("p", { class: "hint" }, words));
  function ask() {
    if (place.hidden) return;
    body.dataset.said = "";
    if (what === "loop") {
      if (!signal.value) return hint("Click a wire of a loop, or name its signal: the loop is opened there.");
      later("response", { signal: signal.value, ...point(), ...bent() }, showResponse);
    } else if (what === "response") {
      if (!input.value || !output.value) return hint("Name the signal where a change is put in, and the one that is looked at.");
      later("response", { input: input.value, output: output.value, ...point(), ...bent() }, showResponse);
    } else if (what === "modes") later("linear", { ...point(), ...bent() }, showModes);
    else if (what === "cycles") later("describe", { ...point(), rest: around.value === "rest" }, showCycles);
  }

  // --- what comes back ---
  const where = ({ t, run, turned, rest }) => {
    if (rest) return "Around the point where the diagram rests.";
    const set = turned.map(([name, value]) => `${name} = ${typeof value === "number" ? short(value) : value?.unit ? `${value.value} ${value.unit}` : JSON.stringify(value)}`);
    return `Linearized at t = ${short(t)} s${run ? ` of the run${set.length ? `, with ${set.join(", ")} set in it` : ""}` : ""}.`;
  };
  /** A slider for each law that bends, over the orders of magnitude around 1. */
  function sliders(laws) {
    return laws.slice(0, 8).map((law) => {
      const on = amplitudes.has(law.signal);
      const number = element("output", {}, on ? short(amplitudes.get(law.signal)) : "off");
      const slider = element("input", { type: "range", min: -5, max: 3, step: 0.05, "aria-label": `Amplitude of ${law.signal}`, disabled: !on });
      slider.value = String(Math.log10(amplitudes.get(law.signal) ?? 0.1));
      const box = element("input", { type: "checkbox" });
      box.checked = on;
      const set = (to) => {
        if (to === null) amplitudes.delete(law.signal);
        else amplitudes.set(law.signal, to);
        slider.disabled = to === null;
        number.textContent = to === null ? "off" : short(to);
        slider.setAttribute("aria-valuetext", number.textContent);
        ask();
      };
      const value = () => Number((10 ** Number(slider.value)).toPrecision(3));
      slider.oninput = () => set(value());
      box.onchange = () => set(box.checked ? value() : null);
      const why = `${law.laws.join(", ")}: ${law.rough ? "no slope where it stands, at" : "off: its slope where it stands, at"} ${short(law.value)}`;
      return element("div", { class: "law", title: why }, element("label", {}, box, ` sine at ${law.signal}`), slider, number, law.rough ? element("b", { class: "unit" }, "no slope") : null);
    });
  }
  /** The sliders stay as they are while one is moved. */
  function keepLaws(laws) {
    const key = laws.map((law) => law.signal).join();
    const old = body.querySelector(".laws");
    if (old?.dataset.key === key) return old;
    const made = element("div", { class: "laws", "data-key": key }, ...sliders(laws));
    return made;
  }
  function fill(answer, ...children) {
    const laws = keepLaws(answer.laws ?? []);
    const rest_ = element("div", { class: "analysis-result" }, ...faultsOf(answer.faults ?? []), ...children);
    if (laws.isConnected) body.querySelector(".analysis-result").replaceWith(rest_);
    else body.replaceChildren(...(laws.children.length ? [laws] : []), rest_);
    if (answer.faults?.length) body.dataset.said = answer.faults.map((one) => one.message).join(" ");
  }
  function showResponse(answer) {
    const { curve, margins, at } = answer;
    const title = answer.signal ? `Loop opened at ${answer.signal}` : `${answer.input} to ${answer.output}`;
    const figures = curve ? charts(title, curve, margins) : [];
    const numbers = margins ? table(`${title}. ${where(at)}`, [], margins.table) : element("p", {}, answer.faults.length ? where(at) : `${title}. ${where(at)}`);
    const lines = answer.lines.length ? element("details", {}, element("summary", {}, "Poles, zeros and blocks"), element("pre", {}, answer.lines.join("\n"))) : null;
    body.dataset.said = margins ? margins.table.slice(0, 4).map((row) => row.join(": ")).join(". ") : title;
    fill(answer, element("div", { class: "charts" }, ...figures, element("div", { class: "numbers" }, numbers, lines)));
  }
  function charts(title, curve, margins) {
    const width = Math.max(280, Math.min(430, (place.clientWidth - 40) / 3));
    const { omega, decibel, degrees, real, imag } = curve;
    const x = () => ({ label: "rad/s", range: [omega[0], omega.at(-1)], log: true });
    const span = (values, least) => {
      const known = values.filter(Number.isFinite);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const more = Math.max(0.06 * (high - low), least);
      return [low - more, high + more];
    };
    const near = (w) => omega.reduce((best, one, k) => (Math.abs(Math.log(one / w)) < Math.abs(Math.log(omega[best] / w)) ? k : best), 0);
    const isMargin = margins && margins.phase_deg !== null;
    const gains = margins?.gain_frequency ? [{ x: margins.gain_frequency, y: -20 * Math.log10(margins.gain), to: 0, text: `${short(20 * Math.log10(margins.gain))} dB` }] : [];
    const phase = isMargin ? degrees[near(margins.crossover)] : 0;
    const border = isMargin ? phase - margins.phase_deg : 0; // an odd multiple of 180
    const phases = isMargin ? [{ x: margins.crossover, y: phase, to: border, text: `${short(margins.phase_deg)}°` }] : [];
    const told = (k) => `${short(omega[k])} rad/s: ${short(decibel[k])} dB, ${short(degrees[k])}°`;
    const common = { width, height: 140, told, announce: app.announce };
    const level = (value) => ({ x: [omega[0], omega.at(-1)], y: [value, value], style: "level" });
    const bode = [
      chart({ ...common, name: `${title}: gain in dB over frequency`, height: 126, x: { ...x(), label: "" }, y: { label: "gain [dB]", range: span(decibel, 3) }, curves: [{ x: omega, y: decibel }, level(0)], marks: gains }),
      chart({ ...common, name: `${title}: phase in degrees over frequency`, x: x(), y: { label: "phase [°]", range: span(degrees, 10), whole: 1 }, curves: [{ x: omega, y: degrees }, ...(isMargin ? [level(border)] : [])], marks: phases }),
    ];
    const reach = Math.min(3, Math.max(1.2, ...real.filter((v, k) => Math.hypot(v, imag[k]) < 3).map(Math.abs)));
    const plane = answerPlane(title, real, imag, reach, { ...common, height: 270, width }, Boolean(margins));
    return [element("div", {}, ...bode), plane];
  }
  function answerPlane(title, real, imag, reach, common, isLoop) {
    const told = (k) => `${short(real[k])} ${imag[k] < 0 ? "-" : "+"} ${short(Math.abs(imag[k]))}j`;
    const curves = [{ x: real, y: imag }, { x: real, y: imag.map((value) => -value), style: "mirror" }];
    const marks = isLoop ? [{ x: -1, y: 0, text: "-1" }] : [];
    const axis = (label) => ({ label, range: [-reach, reach] });
    return chart({ ...common, name: `${title}: Nyquist curve`, x: axis("real part"), y: axis("imaginary part"), curves, marks, circles: isLoop ? [[0, 0, 1]] : [], told, isSquare: true });
  }
  function showModes(answer) {
    const rows = answer.modes.map((mode) => [
      complex(mode.pole), mode.stable ? "yes" : "no", short(mode.damping), short(mode.frequency), short(mode.time_constant), mode.states.join(", ") || "-",
    ]);
    const plane = answer.period ? `z, sampled every ${short(answer.period)} s` : "1/s";
    const sizes = Object.entries(answer.sizes).map(([name, [n, m]]) => `${name} ${n} × ${m}`).join(", ");
    const count = answer.modes.filter((mode) => !mode.stable).length;
    body.dataset.said = `${answer.modes.length} modes, ${count} do not decay.`;
    const made = table(`${answer.states.length} states. ${where(answer.at)}`, [`eigenvalue [${plane}]`, "decays", "damping", "frequency [rad/s]", "time constant [s]", "states that take part"], rows);
    const notes = answer.notes.length ? element("p", { class: "hint" }, answer.notes.join("; ")) : null;
    fill(answer, ...(rows.length ? [made, element("p", {}, `${sizes}: from the inputs of the diagram to the signals that it records.`)] : []), notes ?? "");
  }
  function showCycles(answer) {
    const rows = answer.cycles.map((one) => [
      short(one.omega), short(one.period), one.stable ? "yes" : "no", Object.entries(one.amplitudes).map(([name, value]) => `${name} ${short(value)}`).join(", "), one.kind,
    ]);
    const words = rows.length ? "" : "No limit cycles.";
    body.dataset.said = words || `${rows.length} limit cycles.`;
    const unknown = answer.unknown.map((one) => element("p", { class: "hint" }, `${one.law}: not judged at amplitudes of ${short(one.low)} to ${short(one.high)}.`));
    const made = table(where(answer.at), ["frequency [rad/s]", "period [s]", "stable", "amplitudes", "found by"], rows);
    body.replaceChildren(rows.length ? made : element("p", {}, `${words} ${where(answer.at)}`), ...unknown);
  }

  // --- a band over the scopes ---
  const varied = element("input", { size: 14, "aria-label": "Parameter to vary", list: "analysis-parameters", placeholder: "parameter" });
  const parameters = element("datalist", { id: "analysis-parameters" });
  const number = (label, value) => element("input", { type: "number", step: "any", value, "aria-label": label, class: "short" });
  const [low, high, rows_] = [number("from", ""), number("to", ""), number("Runs", "50")];
  const file = element("input", { size: 14, placeholder: "or sweep.parquet", "aria-label": "File of a saved sweep" });
  const shown = text("Signal of the band", { onchange: () => null });
  const go = element("button", { onclick: () => bandOf() }, "Show the band");
  const none = element("button", { onclick: () => (app.showBand?.(null), hint("The band is gone."), app.announce("The band is gone.")) }, "Remove");
  const ends = element("span", {}, field("from", input), " ", field("to", output));
  function bandOf() {
    const given = file.value ? { file: file.value } : { vary: { [varied.value]: [low, high].map((one) => Number(one.value)) }, n: Number(rows_.value) };
    hint("Running ...");
    later("band", { signals: [shown.value], ...given }, (answer) => {
      app.openScope([shown.value]);
      app.showBand?.(answer);
      body.dataset.said = `Band of ${shown.value} over ${answer.good} of ${answer.rows} runs.`;
      const values = answer.signals[shown.value].map((level) => level[0]);
      const every = Math.max(1, Math.floor(answer.t.length / 10));
      const rows = answer.t.map((t, k) => [short(t), ...values.map((level) => short(level[k]))]).filter((_, k) => k % every === 0);
      body.replaceChildren(element("p", {}, `${body.dataset.said} ${answer.messages.join(" ")}`), element("details", {}, element("summary", {}, "As a table"), table(`Quantiles of ${shown.value}`, ["t [s]", ...answer.quantiles.map((q) => `${100 * q} %`)], rows)));
    });
  }
  app.on("panel", ({ panel }) => parameters.replaceChildren(...panel.parameters.map((row) => element("option", { value: row.path }))));

  // --- the pane ---
  function turn(to) {
    what = to;
    tabs.forEach((tab) => tab.setAttribute("aria-pressed", String(tab.dataset.what === what)));
    const given = { loop: [field("opened at", signal), when], response: [ends, when], modes: [when], cycles: [around],
      band: [field("of", shown), varied, field("from", low), field("to", high), field("runs", rows_), file, go, none, parameters] }[what];
    fields.replaceChildren(...given);
    if (what === "band") hint("Runs of the diagram with a parameter between two values; 5, 50 and 95 % of them are drawn over the scopes.");
    else body.replaceChildren();
    ask();
  }
  function show(isOpen) {
    place.hidden = !isOpen;
    opener.setAttribute("aria-expanded", String(isOpen));
    if (!isOpen) return opener.focus();
    turn(what);
    tabs.find((tab) => tab.dataset.what === what).focus();
  }
  const opener = element("button", { title: "Bode, Nyquist, margins, modes, limit cycles, bands (B)", "aria-expanded": "false", "aria-controls": "analysis", onclick: () => show(place.hidden) }, "Analysis");
  app.keys?.push(["B", "analysis of the selected wire: Bode, Nyquist, margins; again: close"]);
  document.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "b" || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, textarea, select, dialog")) return;
    event.preventDefault();
    show(place.hidden);
  });
  app.on("wire", (name) => {
    if (!name) return;
    signal.value = shown.value = name;
    if (what === "loop") ask();
  });
  app.on("document", ({ signals: known }) => {
    signals.replaceChildren(...known.map((one) => element("option", { value: one.name })));
    ask();
  });
  app.on("knob", () => ask());
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
  const by = element("select", { "aria-label": "Color of blocks", onchange: () => colorBy() }, element("option", { value: "" }, "no colors"), element("option", { value: "rate" }, "by rate"), element("option", { value: "rejected" }, "by rejected steps"));
  let colored = null;
  async function colorBy() {
    colored = by.value ? await app.ask("color", { by: by.value }) : null;
    if (by.value && !colored) by.value = "";
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
      label.setAttribute("class", "color-number");
      label.setAttribute("x", String(x + 3));
      label.setAttribute("y", String(y + 10));
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
