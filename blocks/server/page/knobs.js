/** Knobs: fields and sliders of parameters and inputs, the board of those that are pinned, what was changed and turned. */
import { dialog, element, shown } from "./elements.js";

const ACTIVE = ["running", "paused"];
const TYPED = 500; // ms after which a value that is typed counts, without Return

export function start(app) {
  /** What the server told of each parameter and input. @type {Map<string, any>} */
  const facts = new Map();
  /** What shows one of them: called with its fact, and with an error. @type {Map<string, Set<Function>>} */
  const widgets = new Map();
  const pinned = new Set();
  const ranges = new Map(); // [low, high, is logarithmic] of a slider, as edited
  const isActive = () => ACTIVE.includes(app.state.run?.state);
  const update = (name, error = null) => widgets.get(name)?.forEach((show) => show(facts.get(name), error));

  // --- values -------------------------------------------------------------------------------------------------------

  const waiting = new Map();
  let isBusy = false;
  /** Set a value: at most one message is under way, and of each parameter only the newest value waits. */
  async function turn(name, value, origin) {
    waiting.set(name, [value, origin]);
    if (isBusy) return;
    isBusy = true;
    while (waiting.size) {
      const [next, [wanted, from]] = waiting.entries().next().value;
      waiting.delete(next);
      await put(next, wanted, from, {});
    }
    isBusy = false;
  }
  async function put(name, value, origin, fields) {
    try {
      const { text, t } = await app.connection.ask("set", { name, value, ...fields });
      // A slider says its value itself.
      if (document.activeElement?.type !== "range") app.announce(`${name} is ${text}${t === undefined ? "" : ` from t = ${shown(t)} s on`}.`);
      return true;
    } catch (error) {
      const [{ code, message, cure }] = error.faults ?? [{ code: "", message: error.message, cure: "" }];
      const isFixed = code === "E117";
      update(name, { text: `${code} ${message} ${isFixed ? "" : cure}`, value, isFixed, origin });
      return false;
    }
  }
  async function anew(name, value, origin) {
    if (await put(name, value, origin, { anew: true })) app.begin();
  }
  async function look(names, path = null) {
    const told = await app.connection.ask("knobs", path === null ? { names } : { names, path }).catch(() => null);
    for (const fact of told?.knobs ?? []) {
      facts.set(fact.name, fact);
      update(fact.name);
    }
    if (told) list(told);
    return told;
  }
  app.on("knob", (told) => {
    const fact = facts.get(told.name);
    if (fact) facts.set(told.name, { ...fact, value: told.value, text: told.text, changed: true });
    update(told.name);
    if (told.t !== undefined) row(told);
    note(told.name, { name: told.name, text: told.text, was: told.was });
  });
  app.connection.on("changed", () => look([...facts.keys()]));
  app.on("document", async () => {
    const stored = JSON.parse(sessionStorage.getItem("pinned") ?? "[]"); // the page was loaded again
    await look([...new Set([...facts.keys(), ...stored])]);
    stored.forEach(onto);
  });

  // --- one parameter ------------------------------------------------------------------------------------------------

  /** Field, slider and marks of a parameter or an input. @param {string} name @param {boolean} isOnBoard */
  function knob(name, isOnBoard) {
    const fact = facts.get(name);
    const id = `${isOnBoard ? "board" : "panel"}-${name}`;
    const error = element("span", { class: "error", role: "alert", id: `${id}-error` });
    const changed = element("span", { class: "changed" });
    const reset = element("button", { type: "button", hidden: true, onclick: () => back(name), "aria-label": `Reset ${name}` }, "Reset");
    const field = input(fact, id);
    const slider = fact.low === null || !fact.tunable ? null : slide(name, (value) => turn(name, value, made));
    const off = { type: "button", onclick: () => unpin(name), "aria-label": `Take ${name} off the board` };
    const side = isOnBoard ? element("button", off, "Unpin") : slider && pin(name);
    const parts = [field, side, slider?.input ?? null, isOnBoard ? slider.range : null, changed, isOnBoard ? null : reset, error];
    const made = element("div", { class: "knob", role: "group", "aria-label": name }, ...parts);
    const offer = (value) =>
      element("button", { type: "button", onclick: () => anew(name, value, made) }, `Run anew with ${name} = ${value}`);
    let timer = 0;
    const typed = (isDone) => {
      clearTimeout(timer);
      const value = field.type === "checkbox" ? field.checked : field.value;
      if (value === (field.type === "checkbox" ? facts.get(name).value : facts.get(name).text)) return error.replaceChildren();
      if (!facts.get(name).tunable && isActive()) error.replaceChildren("It cannot change in a run. ", offer(value));
      else if (isDone) turn(name, value, made);
      else timer = setTimeout(() => turn(name, value, made), TYPED);
    };
    field.oninput = () => typed(field.tagName === "SELECT" || field.type === "checkbox");
    field.onkeydown = ({ key }) => {
      if (key === "Enter") typed(true);
      if (key === "Escape") show(facts.get(name), null, true);
    };
    field.onblur = () => typed(true);
    const show = (now, failed, isForced = false) => {
      if (failed && failed.origin !== made) return;
      error.replaceChildren(...(failed ? [failed.text, ...(failed.isFixed ? [" ", offer(failed.value)] : [])] : []));
      field.toggleAttribute("aria-invalid", failed !== null);
      changed.textContent = now.changed ? "● changed" : "";
      changed.title = `The file has ${now.was || "none"}`;
      reset.hidden = !now.changed;
      slider?.show(now);
      if (failed || (document.activeElement === field && !isForced)) return; // what is typed stays
      if (field.type === "checkbox") field.checked = now.value === true;
      else field.value = now.text;
    };
    if (!widgets.has(name)) widgets.set(name, new Set());
    widgets.get(name).add(show);
    show(fact, null);
    made.leave = () => widgets.get(name)?.delete(show);
    return made;
  }

  /** The control for a value: a choice, a check box or a text with its unit. */
  function input(fact, id) {
    const named = { id, "aria-label": fact.name + (fact.input ? " (input)" : ""), "aria-describedby": `${id}-error`, disabled: fact.bound };
    if (fact.type === "bool" && typeof fact.value === "boolean") return element("input", { type: "checkbox", ...named });
    if (fact.choices.length) return element("select", named, ...fact.choices.map((one) => element("option", { value: one }, one)));
    return element("input", { type: "text", autocomplete: "off", spellcheck: "false", ...named });
  }

  /** A slider over the declared range, or over one around the value, which can be edited. */
  function slide(name, act) {
    const { low, high, log, type, unit } = facts.get(name);
    if (!ranges.has(name)) ranges.set(name, [low, high, log]);
    const made = element("input", { type: "range", min: 0, max: 1000, step: 1, "aria-label": `${name} slider` });
    const at = (x) => {
      const [a, b, isLog] = ranges.get(name);
      return 1000 * (isLog ? Math.log(x / a) / Math.log(b / a) : (x - a) / (b - a));
    };
    const value = () => {
      const [a, b, isLog] = ranges.get(name);
      const part = made.value / 1000;
      if (isLog) return Number((a * (b / a) ** part).toPrecision(3));
      const x = a + (b - a) * part;
      const step = type === "int" ? 1 : 10 ** Math.floor(Math.log10((b - a) / 1000));
      return Number((Math.round(x / step) * step).toPrecision(12));
    };
    const say = (x) => made.setAttribute("aria-valuetext", `${shown(x)} ${unit}`.trim());
    made.oninput = () => {
      say(value());
      act(value());
    };
    const end = (index, word) => {
      const edited = element("input", { type: "number", step: "any", value: ranges.get(name)[index], "aria-label": `${word} of the slider of ${name}` });
      edited.onchange = () => {
        const [a, b, isLog] = ranges.get(name).with(index, edited.valueAsNumber);
        if (a < b) ranges.set(name, [a, b, isLog && a > 0]);
        edited.value = ranges.get(name)[index];
        show(facts.get(name));
      };
      return edited;
    };
    const show = (now) => {
      if (typeof now.value !== "number") return;
      say(now.value);
      if (document.activeElement !== made || now.value !== value()) made.value = at(now.value);
    };
    return { input: made, show, range: element("details", {}, element("summary", {}, "range"), end(0, "Least value"), " to ", end(1, "Greatest value"), ` ${unit}`) };
  }

  const pin = (name) => {
    const onclick = () => {
      onto(name)?.focus(); // arrows turn it, and Space runs
      app.announce(`${name} is on the board of knobs.`);
    };
    return element("button", { type: "button", onclick, "aria-label": `Put ${name} on the board` }, "Pin");
  };
  async function back(name) {
    const told = await app.connection.ask("reset", name === null ? {} : { name }).catch((error) => app.announce(error.message));
    if (!told) return;
    app.announce(`${name ?? "All values"} as in the file${told.later?.length ? `; in the next run: ${told.later.join(", ")}` : ""}.`);
  }

  // --- in the panel -------------------------------------------------------------------------------------------------

  let inPanel = [];
  app.on("panel", async ({ panel, place }) => {
    inPanel.forEach((made) => made.leave());
    inPanel = [];
    const names = [...panel.parameters.map(({ path }) => path), ...(panel.path === "" ? panel.inputs.map(({ name }) => name) : [])];
    const told = await look(names, panel.path);
    if (!told || !place.isConnected) return;
    const rows = [...place.querySelectorAll(".rows li")];
    for (const { name, input } of told.knobs) {
      const row = rows.find((one) => (input ? !one.dataset.name && one.firstChild.textContent === name : one.dataset.name === name));
      if (!row) continue;
      inPanel.push(knob(name, false));
      row.querySelector(".value").replaceChildren(inPanel.at(-1));
    }
    if (told.variants.length) place.querySelector("header").after(variants(panel.path, told));
  });

  function variants(path, { variants: choices, variant, anew: isOther }) {
    const choice = element("select", {}, ...choices.map((one) => element("option", { value: one }, one)));
    choice.value = variant;
    choice.onchange = () => app.connection.ask("variant", { path, name: choice.value }).catch((error) => app.announce(error.message));
    const offer = element("button", { type: "button", hidden: !isOther, onclick: () => app.begin() }, `Run anew with ${path} = ${variant}`);
    return element("p", { class: "variants" }, element("label", {}, "Variant ", choice), " ", offer);
  }

  // --- the board ----------------------------------------------------------------------------------------------------

  const board = element("div", { class: "board", role: "group", "aria-label": "Board of knobs" });
  const changes = element("ul", { class: "changes", "aria-label": "Changed values" });
  const keep = element("button", { type: "button", onclick: () => write(null) });
  const resets = element("button", { type: "button", onclick: () => back(null) }, "Reset all");
  const refusal = element("p", { class: "error", role: "alert" });
  const turned = element("tbody", {});
  const head = element("tr", {}, ...["steps", "t (s)", "name", "value"].map((name) => element("th", { scope: "col" }, name)));
  const record = element(
    "details", { hidden: true }, element("summary", {}, "Turned in this run"),
    element("table", {}, element("thead", {}, head), turned),
  );
  const scripts = element("button", { type: "button", hidden: true, onclick: () => script() }, "Script that repeats this run");
  const place = element("section", { id: "knobs", "aria-label": "Knobs", hidden: true }, board, changes, keep, resets, scripts, refusal, record);
  document.getElementById("runbar").append(place);
  const open = () => {
    place.hidden = !pinned.size && !changes.children.length && !turned.children.length;
    sessionStorage.setItem("pinned", JSON.stringify([...pinned]));
  };

  function onto(name) {
    if (pinned.has(name) || !facts.get(name)?.tunable || facts.get(name).low === null) return null;
    pinned.add(name);
    const made = knob(name, true);
    made.prepend(element("label", { for: `board-${name}` }, `${name} `, made.querySelector(".changed")));
    board.append(made);
    open();
    return made.querySelector("input[type=range]");
  }
  function unpin(name) {
    pinned.delete(name);
    const made = [...board.children].find((one) => one.getAttribute("aria-label") === name);
    made?.leave();
    made?.remove();
    open();
    app.announce(`${name} is off the board.`);
  }

  const file = () => app.state.document?.file || "the file";

  /** A changed value in the list of them; null: it is as in the file again. */
  function note(name, change) {
    [...changes.children].find((one) => one.dataset.name === name)?.remove();
    if (change) {
      const { text, was } = change;
      changes.append(element(
        "li", { "data-name": name }, `● ${name} = ${text}${was ? ` (file: ${was})` : ""}`,
        element("button", { type: "button", onclick: () => write([name]), title: `Write it into ${file()}`, "aria-label": `Keep ${name} in ${file()}` }, "Keep"),
        element("button", { type: "button", onclick: () => back(name), "aria-label": `Reset ${name}` }, "Reset"),
      ));
    }
    const count = changes.children.length;
    keep.hidden = resets.hidden = count < 2;
    keep.textContent = `Keep all ${count} in ${file()}`;
    open();
  }
  function row({ steps, t, name, text }) {
    turned.append(element("tr", {}, ...[steps, shown(t, 9), name, text].map((cell) => element("td", {}, String(cell)))));
    record.hidden = false;
    open();
  }
  /** Show all that is changed, and all that was turned. */
  function list(told) {
    changes.replaceChildren();
    note("", null);
    told.changed.forEach((change) => note(change.name, change));
    turned.replaceChildren();
    record.hidden = true;
    told.turned.forEach(row);
  }
  let run = 0;
  app.on("run", ({ id }) => {
    scripts.hidden = id === 0;
    if (id !== run) look([]);
    run = id;
  });

  async function write(names) {
    refusal.textContent = "";
    try {
      const { kept } = await app.connection.ask("keep", names ? { names } : {});
      app.announce(`Kept: ${kept.map(({ old, new: now }) => `${old || "nothing"} is ${now} now`).join(", ") || "nothing had to change"}.`);
    } catch (error) {
      refusal.textContent = error.message;
    }
  }

  async function script() {
    const told = await app.connection.ask("script").catch((error) => (refusal.textContent = error.message) && null);
    if (!told) return;
    const text = element("textarea", { readonly: true, rows: 12, cols: 80, "aria-label": "Script" });
    text.value = told.text;
    const copy = element("button", { type: "button" }, "Copy");
    copy.onclick = async () => {
      text.select();
      await navigator.clipboard?.writeText(told.text).catch(() => document.execCommand("copy"));
      copy.textContent = "Copied";
    };
    const url = URL.createObjectURL(new Blob([told.text], { type: "text/x-python" }));
    const save = element("a", { href: url, download: `${app.state.document.name}_run.py` }, "Save");
    const close = element("button", { type: "button", onclick: () => opened.close() }, "Close");
    const opened = dialog("Script that repeats this run", text, element("p", {}, copy, " ", save, " ", close));
    opened.addEventListener("close", () => URL.revokeObjectURL(url));
  }
}
