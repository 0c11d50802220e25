/** The run: its buttons and keys, its stop time and pace, how it stands, and why it failed. */
import { element, seconds as timed, shown } from "./elements.js";

const ACTIVE = ["running", "paused"];
const WORDS = { none: "no run yet", running: "running", paused: "paused", done: "done", stopped: "stopped", failed: "failed" };

/** Whether a key belongs to what has the focus, and not to the page. */
const isTyped = ({ target, ctrlKey, metaKey, altKey }) =>
  ctrlKey || metaKey || altKey || target.closest("input:not([type=range]), textarea, select, dialog, [contenteditable]");

export function start(app) {
  const bar = document.getElementById("runbar");
  const button = (text, title, action) => {
    const made = element("button", { type: "button", title, onclick: action }, text);
    bar.append(made);
    return made;
  };
  const state = () => app.state.run?.state ?? "none";
  const ask = async (name, fields) => {
    try {
      told.classList.remove("refused");
      return await app.connection.ask(name, fields);
    } catch (error) {
      told.textContent = error.message;
      told.classList.add("refused");
      app.announce(error.message);
      return null;
    }
  };
  /** The stop time: a number of seconds, or a text with a unit; the file's without one. */
  const until = () => {
    const text = stop.value.trim();
    return text ? { stop: Number.isNaN(Number(text)) ? text : Number(text) } : {};
  };
  const settings = () => ({ ...until(), pace: pace() });
  let isBeginning = false;
  const begin = async () => {
    if (isBeginning) return;
    isBeginning = true;
    told.textContent = "preparing ..."; // the first time it is compiled, which takes a moment
    await ask("run", settings());
    isBeginning = false;
  };
  const go = () => (state() === "running" ? ask("pause") : state() === "paused" ? ask("resume", { pace: pace() }) : begin());
  const onward = () => ask("step", ACTIVE.includes(state()) ? {} : until());

  const run = button("Run", "Run or pause (Space)", go);
  const step = button("Step", "One step of the engine (.)", onward);
  const halt = button("Stop", "End the run; its rows stay (s)", () => ask("stop"));
  const again = button("Run anew", "Begin again at the start (r)", begin);

  const stop = element("input", { type: "text", size: 8, autocomplete: "off", spellcheck: "false" });
  stop.onkeydown = ({ key }) => void (key === "Enter" && begin());
  /** In an editor the file is the model, and holds the stop time as well. */
  stop.onchange = async () => {
    const text = stop.value.trim();
    if (text && (await app.entry?.("run.stop", text)) && stop.value.trim() === text) stop.value = "";
  };
  bar.append(element("label", { title: "When the run ends: a number of seconds, or with a unit, as in 5 min" }, "Stop time ", stop));
  const choice = element("select", {});
  for (const [value, text] of [["", "as fast as it goes"], ["1", "real time (1x)"], ["10", "10x"], ["other", "other"]])
    choice.append(element("option", { value }, text));
  const other = element("input", { type: "number", min: "0", step: "any", value: "2", "aria-label": "Pace: simulated seconds per second", hidden: true });
  const pace = () => (choice.value === "other" ? (other.valueAsNumber > 0 ? other.valueAsNumber : 1) : choice.value ? Number(choice.value) : null);
  const paced = () => {
    other.hidden = choice.value !== "other";
    if (state() === "running") ask("resume", { pace: pace() });
  };
  choice.onchange = other.onchange = paced;
  bar.append(element("label", {}, "Pace ", choice), other);

  const progress = element("progress", { max: 1, value: 0, "aria-label": "Progress of the run" });
  const told = element("output", { class: "told" });
  bar.append(progress, told);
  const failure = element("section", { id: "failure", "aria-label": "Why the run failed", hidden: true });
  bar.append(failure);
  app.begin = begin;

  app.keys.push(["Space", "run or pause"], [".", "one step"], ["s", "stop"], ["r", "run anew"]);
  document.addEventListener("keydown", (event) => {
    const action = { " ": go, ".": onward, s: () => ACTIVE.includes(state()) && ask("stop"), r: begin }[event.shiftKey ? event.key.toLowerCase() : event.key];
    if (!action || event.defaultPrevented || event.repeat || isTyped(event) || (event.key === " " && event.target.closest("button, summary, a"))) return;
    event.preventDefault();
    action();
  });

  /** @param {any} told_ how the run stands @returns {string} */
  const sentence = ({ state: now, t, stop: end, steps, rejected, pace: wanted, lag, seconds, start: begun }) => {
    if (now === "none") return WORDS.none;
    const time = (x) => timed(x, [begun ?? 0, Math.max(end ?? t, t)], 6).slice(0, -2);
    const of = end === null || end === undefined ? "" : ` of ${time(end)}`;
    const parts = [`${WORDS[now]}: t = ${time(t)}${of} s`, `${steps} steps, ${rejected} rejected`];
    if (now === "running" && wanted !== null) parts.push(lag > 0.1 ? `${shown(lag, 2)} s behind ${shown(wanted)}x` : `at ${shown(wanted)}x`);
    else if (["running", "done"].includes(now) && wanted === null && seconds > 0 && t > (begun ?? 0)) parts.push(`${shown((t - (begun ?? 0)) / seconds, 2)}x real time`);
    if (app.state.document?.coupled) parts.push("sets act at communication points");
    return parts.join(" · ");
  };

  let before = "none";
  app.on("run", (now) => {
    const isActive = ACTIVE.includes(now.state);
    run.textContent = now.state === "running" ? "Pause" : now.state === "paused" ? "Resume" : "Run";
    halt.disabled = !isActive;
    step.disabled = now.state === "running";
    again.disabled = now.state === "none";
    progress.hidden = !(now.stop > now.start);
    if (!progress.hidden) progress.value = (now.t - now.start) / (now.stop - now.start);
    bar.dataset.state = now.state;
    told.textContent = sentence(now);
    told.classList.remove("refused");
    if (now.state !== before) {
      before = now.state;
      if (now.state !== "failed") app.announce(`Run: ${sentence(now)}`);
      fail(now.state === "failed" ? now : null);
    }
  });
  app.on("document", ({ settings: known }) => {
    // A diagram with faults has no settings that were read, but its file says when a run ends.
    stop.placeholder = typeof known?.stop === "number" ? `${shown(known.stop)} s` : known?.until || "no end";
  });

  /** The fault of a failed run, with the block in the drawing and the last rows at its inputs. */
  function fail(now) {
    failure.replaceChildren();
    failure.hidden = now === null;
    document.querySelectorAll("#drawing .failing").forEach((marked) => marked.classList.remove("failing"));
    if (now === null) return;
    for (const { code, place, message, cure } of now.faults) failure.append(element("p", {}, element("strong", {}, `${code} ${place}: `), message, " ", cure));
    app.announce(`The run failed. ${failure.textContent}`);
    const { failing } = now;
    if (!failing) return;
    mark(failing.block);
    failure.append(element("button", { type: "button", onclick: () => app.reveal(failing.block) }, `Show ${failing.block}`), " ");
    failure.append(element("button", { type: "button", onclick: () => (failure.hidden = true) }, "Hide"));
    if (!failing.signals.length) return;
    const head = ["t (s)", ...failing.signals].map((name) => element("th", { scope: "col" }, name));
    const rows = failing.rows.map((row, k) => element("tr", {}, ...[failing.t[k], ...row].map((x, j) => element("td", {}, shown(x, j ? 7 : 12)))));
    failure.append(
      element("table", {}, element("caption", {}, `The last steps of what ${failing.block} reads and gives`), element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...rows.slice(-5))),
    );
  }
  const mark = (path) => {
    const local = app.state.level ? (path.startsWith(`${app.state.level}.`) ? path.slice(app.state.level.length + 1) : "") : path;
    for (const block of document.querySelectorAll("#drawing [data-path]"))
      block.classList.toggle("failing", local !== "" && (local === block.dataset.path || local.startsWith(`${block.dataset.path}.`)));
  };
  app.on("drawn", () => state() === "failed" && app.state.run.failing && mark(app.state.run.failing.block));
}
