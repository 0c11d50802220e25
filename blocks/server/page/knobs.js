/** Knobs: fields and sliders of parameters and inputs, the board of those that are pinned, what was changed and turned. */
import { anew, dialog, element, give, isTyped, settle, shown, table, valueOf } from "./elements.js";

const TYPED = 500; // ms after which a value that is typed counts, without Return
const PAUSE = 100; // ms between two looks at what is changed
const ELEMENTS = 6; // of a vector that has a field for each

export function start(app) {
  /** What shows a parameter or an input, by place and name. @type {Map<string, any>} */
  const knobs = new Map();
  const isTunable = (fact) => fact.low !== null && !fact.why;
  const button = (text, onclick, label = null) => element("button", { type: "button", onclick, "aria-label": label }, text);

  // --- values -------------------------------------------------------------------------------------------------------

  const waiting = new Map();
  let isBusy = false;
  /** Set a value: at most one message is under way, and of each parameter only the newest value waits. */
  async function turn(name, value, made) {
    waiting.set(name, [value, made]);
    if (isBusy) return;
    isBusy = true;
    while (waiting.size) {
      const [next, [wanted, from]] = waiting.entries().next().value;
      waiting.delete(next);
      await put(next, wanted, from);
    }
    isBusy = false;
  }
  async function put(name, value, made, fields = {}) {
    try {
      const { text, t } = await app.connection.ask("set", { name, value, ...fields });
      made.refuse();
      // A slider says its value itself.
      if (document.activeElement?.type !== "range") app.announce(`${name} is ${text}${t === null ? "" : ` from t = ${shown(t)} s on`}.`);
      return true;
    } catch (error) {
      const [{ code, message, cure }] = error.faults ?? [{ code: "", message: error.message, cure: "" }];
      const offer = code === "E117" ? button(`Run anew with ${name} = ${[value].flat().join(", ")}`, async () => (await put(name, value, made, { anew: true })) && app.begin()) : cure;
      made.refuse(`${code} ${message} `, offer);
      return false;
    }
  }
  /** Turn several, as [name, value], at once; isLast: where they are edited, write them as one step. refused: what shows a name. */
  app.turnAll = (values, refused, isLast) => {
    if (isLast && app.putAll) return values.forEach(([name]) => waiting.delete(name)), app.putAll(values, refused);
    values.forEach(([name, value]) => turn(name, value, refused(name)));
  };
  let [isLooking, isAgain] = [false, false];
  /** Ask for all that is shown; one question at a time, and not too many. */
  async function look() {
    isAgain = true;
    if (isLooking) return;
    isLooking = true;
    while (isAgain) {
      isAgain = false;
      const names = [...knobs.values()].filter((one) => one.isConnected).map((one) => one.fact.name);
      const told = await app.connection.ask("knobs", { names: [...new Set(names)], since: turned.children.length }).catch(() => null);
      told?.knobs.forEach((fact) => ["panel", "board"].forEach((place) => knobs.get(`${place}-${fact.name}`)?.show(fact)));
      if (told) anew("changes", () => list(told));
      await new Promise((resolve) => setTimeout(resolve, PAUSE));
    }
    isLooking = false;
  }
  app.connection.on("changed", () => {
    look();
    app.emit("knob");
  });
  async function back(name) {
    const told = await app.ask("reset", name === null ? {} : { name });
    if (!told) return;
    knobs.forEach((one) => [null, one.fact.name].includes(name) && one.refuse());
    app.announce(`${name ?? "All values"} as in the file${told.later.length ? `; in the next run: ${told.later.join(", ")}` : ""}.`);
  }

  // --- one parameter ------------------------------------------------------------------------------------------------

  /** Field, slider and marks of a parameter or an input; what is typed into it stays when it is shown anew. */
  app.knob = (fact, place = "panel") => {
    const id = `${place}-${fact.name}`;
    const count = Array.isArray(fact.value) && fact.value.every(Number.isFinite) ? fact.value.length : 0;
    const kind = JSON.stringify([fact.type, fact.choices, fact.bound, fact.why, fact.low === null, count]);
    if (knobs.get(id)?.dataset.kind !== kind) knobs.set(id, made(fact, id, place === "board", count > 0 && count <= ELEMENTS ? count : 0, kind));
    knobs.get(id).show(fact);
    return knobs.get(id);
  };

  function made(fact, id, isOnBoard, count, kind) {
    const { name } = fact;
    const fields = Array.from({ length: count || 1 }, (_, k) => input(fact, k ? `${id}-${k}` : id, count ? `${name}[${k}]` : name));
    const [field] = fields;
    const error = element("span", { class: "error", role: "alert", id: `${id}-error` });
    const [changed, note] = [element("span", { class: "changed" }), element("span", { class: "unit" })];
    const reset = button("Reset", () => back(name), `Reset ${name}`);
    const slider = isTunable(fact) ? slide(name, (value) => turn(name, value, root)) : null;
    const side = isOnBoard ? button("Unpin", () => unpin(name), `Take ${name} off the board`) : slider && button("Pin", () => pin(root.fact), `Put ${name} on the board`);
    const parts = isOnBoard ? [element("label", { for: id }, `${name} `, changed), ...fields] : fields;
    const more = [note, side, slider?.input ?? null, ...(isOnBoard ? [] : [changed, reset]), error];
    const root = element("div", { class: "knob", role: "group", "aria-label": name, "data-kind": kind }, ...parts, ...more);
    const isBox = field.type === "checkbox";
    let [timer, isOpen] = [0, false]; // isOpen: what was taken waits for an answer, or was refused
    const sent = new Set(); // fields whose values were taken since they were filled
    const take = () => {
      clearTimeout(timer);
      const typed = fields.filter(isTyped);
      if (!typed.length) return;
      isOpen = true;
      typed.forEach((one) => (sent.add(one), settle(one)));
      // Elements that nobody typed stay as the file has them.
      const values = fields.map((one) => (sent.has(one) || !app.put ? valueOf(one) : null));
      (app.put ?? turn)(name, count ? values : values[0], root);
    };
    if (slider && app.put)
      slider.input.onchange = () => {
        waiting.delete(name); // what was turned on the way there would stand over what is written
        app.put(name, slider.value(), root);
      };
    const fill = () => {
      sent.clear();
      fields.forEach((one, k) => give(one, isBox ? root.fact.value : count ? String(root.fact.value[k]) : root.fact.text));
      isFilled = true;
    };
    let isFilled = false;
    if (slider) slider.input.onblur = () => root.show(root.fact);
    for (const one of fields) {
      one.oninput = () => {
        clearTimeout(timer);
        timer = setTimeout(take, isBox || fact.choices.length ? 0 : TYPED);
      };
      one.onchange = take; // Return, or the next field
      one.onblur = () => root.show(root.fact);
      one.onkeydown = ({ key }) => {
        if (key !== "Escape") return;
        clearTimeout(timer);
        root.refuse();
        fill();
      };
    }
    /** Say what was refused, beside what was typed; without words it was taken. */
    root.refuse = (...words) => {
      isOpen = words.length > 0;
      error.replaceChildren(...words);
      fields.forEach((one) => (one.ariaInvalid = isOpen ? "true" : null));
    };
    root.show = (now) => {
      root.fact = now;
      changed.textContent = now.changed ? "● changed" : "";
      changed.title = `The file has ${now.was || "none"}`;
      reset.hidden = !now.changed;
      note.textContent = now.bound && now.value !== null ? `${shown(now.value)} ${now.unit}` : count ? now.unit : "";
      slider?.show(now);
      // What is typed stays.
      if (!isFilled || (!isOpen && !fields.includes(document.activeElement) && !fields.some(isTyped))) fill();
    };
    return root;
  }

  /** The control for a value: a choice, a check box or a text with its unit. */
  function input(fact, id, label) {
    const named = { id, "aria-label": label, "aria-describedby": `${id}-error`, disabled: fact.bound && !app.put };
    if (fact.type === "bool" && typeof fact.value === "boolean") return element("input", { type: "checkbox", ...named });
    if (fact.choices.length) return element("select", named, ...fact.choices.map((one) => element("option", {}, one)));
    return element("input", { type: "text", autocomplete: "off", spellcheck: "false", ...named });
  }

  /** A slider over the declared range, or over one around the value, which follows it when the slider is left. */
  function slide(name, act) {
    let fact = null;
    const made = element("input", { type: "range", min: 0, max: 1000, step: 1, "aria-label": `${name} slider` });
    const value = ({ low, high, log, type }) => {
      if (log) return Number((low * (high / low) ** (made.value / 1000)).toPrecision(3));
      const step = type === "int" ? 1 : 10 ** Math.floor(Math.log10((high - low) / 1000));
      return Number((Math.round((low + ((high - low) * made.value) / 1000) / step) * step).toPrecision(12));
    };
    const say = (x) => made.setAttribute("aria-valuetext", `${shown(x)} ${fact.unit}`.trim());
    made.oninput = () => {
      say(value(fact));
      act(value(fact));
    };
    const show = (now) => {
      if (fact && document.activeElement === made) return; // it says its value itself
      fact = now;
      const { value: x, low, high, log, unit } = fact;
      made.title = `${shown(low)} to ${shown(high)} ${unit}`.trim();
      made.value = 1000 * (log ? Math.log(x / low) / Math.log(high / low) : (x - low) / (high - low));
      say(x);
    };
    return { input: made, show, value: () => value(fact) };
  }

  // --- the board ----------------------------------------------------------------------------------------------------

  const board = element("div", { class: "board", role: "group", "aria-label": "Board of knobs" });
  const changes = element("ul", { class: "changes", "aria-label": "Changed values" });
  const keep = button("", () => write(null));
  const resets = button("Reset all", () => back(null));
  const refusal = element("p", { class: "error", role: "alert" });
  const rows = table(["steps", "t (s)", "name", "value"], []);
  const turned = rows.tBodies[0];
  const record = element("details", {}, element("summary", {}, "Turned in this run"), rows);
  const scripts = button("Script that repeats this run", () => script());
  const place = element("section", { id: "knobs", "aria-label": "Knobs", hidden: true }, board, changes, keep, resets, scripts, refusal, record);
  document.getElementById("runbar").append(place);
  const open = () => {
    record.hidden = !turned.children.length;
    place.hidden = !board.children.length && !changes.children.length && record.hidden;
  };
  app.on("document", ({ editing }) => editing && document.getElementById("scopes").append(place)); // where it moves nothing
  const stored = () => sessionStorage.setItem("pinned", JSON.stringify([...board.children].map((one) => one.fact.name)));
  function pin(fact) {
    board.append(app.knob(fact, "board"));
    open();
    stored();
    board.lastChild.querySelector("input[type=range]").focus(); // arrows turn it, and Space runs
    app.announce(`${fact.name} is on the board of knobs.`);
  }
  function unpin(name) {
    knobs.get(`board-${name}`).remove();
    open();
    stored();
    app.announce(`${name} is off the board.`);
  }
  app.on("document", async () => {
    const names = JSON.parse(sessionStorage.getItem("pinned") ?? "[]"); // also when the page was loaded again
    const told = names.length ? await app.ask("knobs", { names }) : null;
    board.replaceChildren(...(told?.knobs ?? []).filter(isTunable).map((fact) => app.knob(fact, "board")));
    look();
  });

  const file = () => app.state.document?.file || "the file";
  let known = "";
  /** Show all that is changed, and what more was turned. */
  function list(told) {
    turned.append(...table([], told.turned.map(([steps, t, ...rest]) => [steps, shown(t, 9), ...rest])).tBodies[0].children);
    if (JSON.stringify(told.changed) !== known) {
      known = JSON.stringify(told.changed);
      const at = [...changes.querySelectorAll("button")].indexOf(document.activeElement);
      changes.replaceChildren(...told.changed.map(([name, text, was]) =>
        element("li", {}, `● ${name} = ${text}${was ? ` (file: ${was})` : ""}`,
          button("Keep", () => write([name]), `Keep ${name} in ${file()}`), button("Reset", () => back(name), `Reset ${name}`))));
      if (at >= 0) changes.querySelectorAll("button")[Math.min(at, 2 * told.changed.length - 1)]?.focus();
    }
    keep.hidden = resets.hidden = told.changed.length < 2;
    keep.textContent = `Keep all ${told.changed.length} in ${file()}`;
    open();
  }
  let run = 0;
  app.on("run", ({ id }) => {
    scripts.hidden = id === 0;
    if (id === run) return;
    run = id;
    turned.replaceChildren();
    look();
  });

  /** Ask; what is refused is told below the changes. */
  function tried(name, fields) {
    refusal.textContent = "";
    return app.connection.ask(name, fields).catch((error) => (refusal.textContent = error.message) && null);
  }
  async function write(names) {
    const told = await tried("keep", names ? { names } : {});
    if (told) app.announce(`Kept: ${told.kept.map(({ old, new: now }) => `${old || "nothing"} is ${now} now`).join(", ") || "nothing had to change"}.`);
  }
  async function script() {
    const told = await tried("script");
    if (!told) return;
    const text = element("textarea", { readonly: true, rows: 12, cols: 80, "aria-label": "Script" });
    text.value = told.text;
    const save = element("a", { href: `data:text/x-python;charset=utf-8,${encodeURIComponent(told.text)}`, download: `${app.state.document.name}_run.py` }, "Save");
    const opened = dialog("Script that repeats this run", text, element("p", {}, save, " ", button("Close", () => opened.close())));
    text.select();
  }
}
