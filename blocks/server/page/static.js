/** In place of the connection: the answers that the server would give stand in the page, with the rows of one run. */
import { Curve } from "./curves.js";

/** What is not answered here. */
export class Refusal extends Error {
  constructor(faults) {
    super(faults.map((f) => f.message).join("\n"));
    this.faults = faults;
  }
}

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

/** As connection.js gives it. */
export function connect() {
  const { hello, answers, rows } = JSON.parse(document.getElementById("content").textContent);
  const t = new Float64Array(bytes(rows.t));
  const values = new Float32Array(bytes(rows.values)); // a column after the other
  const all = new Curve({ t, columns: rows.columns.map((_, k) => values.subarray(k * t.length, (k + 1) * t.length)) });
  const known = new Map(answers.map(([asked, told]) => [JSON.stringify(asked), told]));
  const callbacks = new Map();
  const tell = (is, message) => (callbacks.get(is) ?? []).forEach((callback) => callback(message));
  const own = {
    /** All rows, whatever the scope shows of them. */
    scope({ scope, signals: asked }) {
      const signals = asked.flatMap((name) => (Object.hasOwn(rows.units, name) ? [name] : Object.hasOwn(rows.elements, name) ? rows.elements[name] : []));
      const header = { scope, kind: "run", of: 0, signals, units: signals.map((name) => rows.units[name]) };
      const columns = signals.map((name) => all.columns[rows.columns.indexOf(name)]);
      queueMicrotask(() => tell("frame", { header, t, columns }));
      return { is: "scope", scope };
    },
    drawn: () => ({ is: "drawn" }),
    values({ t: time }) {
      const of = (name) => all.at(rows.columns.indexOf(name), time);
      const isInside = time >= t[0] && time <= all.last;
      const told = Object.entries(isInside ? rows.elements : {}).map(([name, names]) => [name, names[0] === name ? of(name) : names.map(of)]);
      return { is: "values", t: time, values: Object.fromEntries(told) };
    },
  };
  queueMicrotask(() => tell("hello", hello));
  return {
    async ask(name, fields = {}) {
      const found = own[name]?.(fields) ?? known.get(JSON.stringify([name, ...Object.values(fields)]));
      if (!found) throw new Refusal([{ code: "", place: name, message: "This page holds one run: nothing runs here.", cure: "" }]);
      tell(found.is, found);
      return found;
    },
    on: (is, callback) => callbacks.set(is, [...(callbacks.get(is) ?? []), callback]),
    onFrame: (callback) => callbacks.set("frame", [...(callbacks.get("frame") ?? []), callback]),
    close() {},
  };
}
