/** The page: one `app` that all its parts share, and the parts. */
import { connect } from "./connection.js";
import { counted, dialog, element } from "./elements.js";
import * as analysis from "./analysis.js";
import * as drawing from "./drawing.js";
import * as edit from "./edit.js";
import * as knobs from "./knobs.js";
import * as lists from "./lists.js";
import * as panel from "./panel.js";
import * as runbar from "./runbar.js";
import * as scopes from "./scopes.js";

const connection = connect();
const listeners = new Map();

/**
 * What the parts share. Events: "document" (also when the file changed), "run", "knob", "level" (the open subdiagram),
 * "select" (the path of a block, or null), "picked" (paths of all that is selected, where it is edited), "wire" (the name of a signal, or null), "panel" ({panel, place}: shown anew),
 * "drawn" (the svg of the level), "cursor" (t), "values" (of all signals at the cursor), "closed".
 */
const app = {
  connection,
  /** hello's document, run, svg; the open level; the selected block; the selected signal. */
  state: { document: null, run: null, svg: "", level: "", selected: null, wire: null },
  /** Keys of the whole page, for `?`: [keys, what they do]. @type {[string, string][]} */
  keys: [],
  on(name, callback) {
    listeners.set(name, [...(listeners.get(name) ?? []), callback]);
  },
  emit(name, value) {
    (listeners.get(name) ?? []).forEach((callback) => callback(value));
  },
  /** Select a block by its path; null: the diagram itself. */
  select(path) {
    app.state.selected = path;
    app.emit("select", path);
  },
  /** Select a signal by its name, as a click on its wire does. */
  selectWire(name) {
    app.state.wire = name;
    app.emit("wire", name);
  },
  /** A block as the document lists it. */
  block: (path) => app.state.document?.blocks.find((one) => one.path === path),
  /** Show these signals in a scope; the scopes replace this. */
  openScope(signals) {
    app.announce(`${signals.join(", ")}: there are no scopes here.`);
  },
  /** Say something to who hears the page. */
  announce(text) {
    const place = document.getElementById("announcer");
    place.textContent = "";
    requestAnimationFrame(() => (place.textContent = text));
  },
  /** Ask the server; what it refuses is announced. @returns {Promise<any>} null where it was refused */
  async ask(name, fields) {
    try {
      return await connection.ask(name, fields);
    } catch (error) {
      app.announce(error.message);
      return null;
    }
  },
};

app.help = () => {
  const rows = app.keys.flatMap(([keys, what]) => [
    element("dt", {}, ...keys.split(" ").map((key) => (key === "or" ? " or " : element("kbd", {}, key)))),
    element("dd", {}, what),
  ]);
  const close = element("button", { onclick: () => shown.close() }, "Close");
  const shown = dialog("Keys", element("h2", {}, "Keys"), element("dl", { class: "keys" }, ...rows), close);
  close.focus();
};

/** Bars between the panes: dragged, or moved by the arrow keys. */
function splitters() {
  for (const bar of document.querySelectorAll(".splitter")) {
    const pane = document.getElementById(bar.dataset.sizes);
    const isWide = bar.ariaOrientation === "vertical";
    const sign = bar.dataset.sizes === "lists" ? 1 : -1;
    const size = () => (isWide ? pane.offsetWidth : pane.offsetHeight);
    const resize = (pixels) => {
      const most = 0.7 * (isWide ? innerWidth : innerHeight);
      const now = Math.round(Math.min(Math.max(pixels, 80), most));
      document.documentElement.style.setProperty(`--${bar.dataset.sizes}`, `${now}px`);
      bar.ariaValueNow = now;
      app.emit("resize", bar.dataset.sizes);
    };
    bar.ariaValueNow = size();
    bar.onpointerdown = (down) => {
      const begun = size();
      bar.setPointerCapture(down.pointerId);
      bar.onpointermove = (move) => resize(begun + sign * (isWide ? move.clientX - down.clientX : move.clientY - down.clientY));
      bar.onpointerup = () => (bar.onpointermove = null);
    };
    bar.onkeydown = ({ key }) => {
      const step = { ArrowLeft: -16, ArrowUp: -16, ArrowRight: 16, ArrowDown: 16 }[key];
      if (step) resize(size() + sign * step);
    };
  }
}

for (const part of [drawing, edit, lists, panel, runbar, knobs, scopes, analysis]) part.start(app);
app.keys.push(["?", "these keys"], ["Tab", "from pane to pane; arrows move inside lists"]);
splitters();
document.addEventListener("keydown", (event) => {
  if (event.key === "?" && !event.target.closest("input, textarea, dialog")) app.help();
});

connection.on("hello", (hello) => {
  if (app.state.server && app.state.server !== hello.server) return location.reload();
  Object.assign(app.state, hello);
  app.emit("document", hello.document);
  app.emit("run", hello.run);
});
connection.on("document", (told) => {
  app.state.document = told;
  app.state.svg = told.svg;
  app.emit("document", told);
  if (!told.editing) app.announce(`${told.file || told.name} was read again: ${counted(told.faults.length, "fault")}.`);
});
connection.on("run", (run) => {
  app.state.run = run;
  app.emit("run", run);
});
connection.on("knob", (knob) => app.emit("knob", knob));
connection.on("closed", async () => {
  const gone = document.getElementById("gone");
  gone.textContent = `The server has ended. What is shown stays; run blocks ${app.state.document?.editing ? "edit" : "live"} again, and open the address that it prints.`;
  gone.hidden = false;
  app.emit("closed");
  // The same server lets this page in again, as after a sleep of the machine; another one at this address does not.
  let answer = null;
  while (!answer) {
    await new Promise((resolve) => setTimeout(resolve, 1000));
    answer = await fetch("./", { method: "HEAD", cache: "no-store" }).catch(() => null);
  }
  if (answer.ok) return location.reload();
  gone.textContent = "Another server has this address now. What is shown stays; open the address that blocks live printed.";
});
app.on("document", (told) => {
  document.body.dataset.revision = told.revision;
  document.title = `${told.name} - blocks`;
  document.getElementById("title").textContent = told.name;
});
