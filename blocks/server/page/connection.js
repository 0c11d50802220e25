/** The connection to the server: questions with answers, broadcasts, binary frames. */

/** @typedef {{code: string, place: string, message: string, cure: string, block: string, warning: boolean}} Fault */

/** What the server refuses, with all its faults. */
export class Refusal extends Error {
  /** @param {Fault[]} faults */
  constructor(faults) {
    super(faults.map((f) => `${f.code} ${f.place}: ${f.message} ${f.cure}`).join("\n"));
    this.faults = faults;
  }
}

/** Connect; the answer is ready when the server has said hello. */
export function connect() {
  const url = new URL("ws", location.href.replace(/^http/, "ws").replace(/[?#].*$/, ""));
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  /** @type {Map<number, {resolve: Function, reject: Function}>} */
  const waiting = new Map();
  /** @type {Map<string, Function[]>} */
  const callbacks = new Map();
  let number = 0;
  const tell = (is, message) => (callbacks.get(is) ?? []).forEach((callback) => callback(message));
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return tell("frame", decoded(data));
    const message = JSON.parse(data);
    const asked = waiting.get(message.re);
    waiting.delete(message.re);
    if (message.is === "error") asked?.reject(new Refusal(message.faults));
    else {
      tell(message.is, message);
      asked?.resolve(message);
    }
  };
  socket.onclose = () => {
    waiting.forEach(({ reject }) => reject(new Error("The server has gone.")));
    waiting.clear();
    tell("closed", {});
  };
  return {
    /** Ask the server; a refusal is thrown as Refusal. @param {string} name @param {object} fields */
    ask(name, fields = {}) {
      if (socket.readyState !== WebSocket.OPEN) return Promise.reject(new Error("The server has gone."));
      number += 1;
      const id = number;
      socket.send(JSON.stringify({ do: name, id, ...fields }));
      return Object.assign(new Promise((resolve, reject) => waiting.set(id, { resolve, reject })), { id });
    },
    /** End what was asked, where that takes long: it is refused then. @param {any} asked what `ask` gave */
    cancel(asked) {
      return this.ask("cancel", { of: asked.id ?? 0 }).catch(() => null);
    },
    /** Call back at each message of a kind: "hello", "document", "run", ..., "frame", "closed". */
    on(is, callback) {
      callbacks.set(is, [...(callbacks.get(is) ?? []), callback]);
    },
    onFrame(callback) {
      this.on("frame", callback);
    },
    close: () => socket.close(),
  };
}

/** A binary frame: its header, times and columns. @param {ArrayBuffer} buffer */
function decoded(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  const t = new Float64Array(buffer, at, header.count);
  at += 8 * header.count;
  const columns = header.signals.map((_, k) => new Float32Array(buffer, at + 4 * k * header.count, header.count));
  return { header, t, columns };
}
