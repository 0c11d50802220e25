/** The page: one `app` that all its parts share, and the parts. */
import { connect } from "./connection.js";
import * as drawing from "./drawing.js";
import * as runbar from "./runbar.js";
import * as scopes from "./scopes.js";

const connection = connect();
const listeners = new Map();
const app = {
  connection,
  /** What is shown: hello's document, run, svg; the open level; the selected path. */
  state: { document: null, run: null, svg: "", level: "", selected: null },
  on(name, callback) {
    listeners.set(name, [...(listeners.get(name) ?? []), callback]);
  },
  emit(name, value) {
    (listeners.get(name) ?? []).forEach((callback) => callback(value));
  },
  select(path) {
    app.state.selected = path;
    app.emit("select", path);
  },
  announce(text) {
    document.getElementById("announcer").textContent = text;
  },
};
for (const part of [drawing, runbar, scopes]) part.start(app);

connection.on("hello", (hello) => {
  if (app.state.server && app.state.server !== hello.server) return location.reload();
  Object.assign(app.state, hello);
  document.title = `${hello.document.name} - blocks`;
  app.emit("document", hello.document);
  app.emit("run", hello.run);
});
connection.on("document", (document_) => {
  app.state.document = document_;
  app.emit("document", document_);
});
connection.on("run", (run) => {
  app.state.run = run;
  app.emit("run", run);
});
connection.on("knob", (knob) => app.emit("knob", knob));
