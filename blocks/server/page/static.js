/** In place of the connection: the answers that the server would give stand in the page, with the rows of one run. */

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
  const column = (name) => {
    const first = rows.columns.indexOf(name) * t.length;
    return first < 0 ? null : values.subarray(first, first + t.length);
  };
  const known = new Map(answers.map(([asked, told]) => [JSON.stringify(asked), told]));
  const callbacks = new Map();
  const tell = (is, message) => (callbacks.get(is) ?? []).forEach((callback) => callback(message));
  const own = {
    /** All rows between two times, with one row to either side. */
    scope({ scope, signals, t0 = -Infinity, t1 = Infinity }) {
      const names = signals.flatMap((name) => rows.elements[name] ?? []);
      const from = Math.max(0, t.findLastIndex((one) => one < t0));
      const after = t.findIndex((one) => one > t1);
      const to = after < 0 ? t.length : after + 1;
      const header = { scope, run: 1, kind: "replace", signals: names, count: to - from };
      tell("frame", { header, t: t.slice(from, to), columns: names.map((name) => column(name).slice(from, to)) });
      return { is: "scope", scope };
    },
    unscope: ({ scope }) => ({ is: "unscope", scope }),
    /** The row at or before a time. */
    values({ t: at }) {
      const row = Math.max(0, t.findLastIndex((one) => one <= at));
      const of = (names) => names.map((name) => column(name)[row]);
      const told = Object.entries(rows.elements).map(([name, names]) => [name, names.length > 1 ? of(names) : of(names)[0]]);
      return { is: "values", t: t[row], values: Object.fromEntries(told) };
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
