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
  /** Where a time belongs among the rows: behind all that are not later. */
  const after = (time) => {
    let [low, high] = [0, t.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle + 1;
      else high = middle;
    }
    return low;
  };
  const own = {
    /** All rows between two times, with one more on each side. */
    scope({ scope, signals, t0, t1 }) {
      const names = signals.flatMap((name) => rows.elements[name] ?? (rows.units[name] === undefined ? [] : [name]));
      const from = Math.max(0, after(t0 ?? -Infinity) - 1);
      const to = Math.min(t.length, after(t1 ?? Infinity) + 1);
      const units = names.map((name) => rows.units[name]);
      const header = { scope, kind: "run", of: 0, signals: names, units, count: to - from };
      const columns = names.map((name) => column(name).slice(from, to));
      queueMicrotask(() => tell("frame", { header, t: t.slice(from, to), columns }));
      return { is: "scope", scope };
    },
    drawn: () => ({ is: "drawn" }),
    /** Values at a time, linear between rows as the plots are. */
    values({ t: time }) {
      const row = after(time) - 1;
      const share = (time - t[row]) / (t[row + 1] - t[row]);
      const of = (name) => {
        const [a, b] = [column(name)[row], column(name)[row + 1]];
        return t[row] === time ? a : (1 - share) * a + share * b;
      };
      const isInside = row >= 0 && time <= t[t.length - 1];
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
