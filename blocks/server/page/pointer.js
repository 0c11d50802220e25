/** Editing by hand: blocks are moved, wires drawn and branched, files dropped. Nothing is changed before it is dropped. */
import { element } from "./elements.js";

const GRID = 10;
const NEAR = 12; // pixels of the screen from which a port is met
const LEAST = 4; // pixels before a press is a drag

/** The ports of a box with their places in the drawing. kind: "in" or "out". */
export function ports(app, name, kind) {
  const box = app.drawing.boxes().get(name);
  if (!box?.dataset[kind]) return [];
  const [x, y] = center(box);
  return box.dataset[kind].split(";").map((one) => {
    const [, dx, dy, port] = one.match(/^(\S+) (\S+) ?(.*)$/);
    const own = port.replaceAll("%3B", ";").replaceAll("%25", "%");
    const isTerminal = box.matches(".input, .output");
    return { port: isTerminal ? name : `${name}.${own}`, x: x + Number(dx), y: y + Number(dy), kind };
  });
}
const center = (box) => box.dataset.at.split(" ").map(Number);
/** By input that is wired, its source. */
export const driven = (app) => new Map([...app.drawing.stage.querySelectorAll("g.wire[data-sink]")].map(({ dataset }) => [dataset.sink, dataset.net]));
/** A point of the screen in the drawing. */
function point(app, { clientX, clientY }) {
  const { left, top } = app.drawing.stage.getBoundingClientRect();
  return [(clientX - left) / app.drawing.scale(), (clientY - top) / app.drawing.scale()];
}
/** A place for a new block: from the center of some box, as positions are counted from nothing that the page knows. */
export function near(app, event) {
  const [x, y] = point(app, event);
  const [first] = app.drawing.boxes();
  if (!first) return { at: [x, y] };
  const [bx, by] = center(first[1]);
  return { at: [x - bx, y - by], of: first[0] };
}
/** Type another name over that of a box. take: whether it was taken; who typed one that was not may mend it. */
export function typedOver(app, name, take) {
  const box = app.drawing.boxes().get(name);
  const text = (box.querySelector("text.name") ?? box).getBoundingClientRect();
  const around = app.drawing.view.getBoundingClientRect();
  const field = element("input", { class: "typed", "aria-label": `Name of ${name}`, spellcheck: "false", autocomplete: "off" });
  field.value = name;
  field.style.left = `${text.x + text.width / 2 - around.x}px`;
  field.style.top = `${text.y + text.height / 2 - around.y}px`;
  let isAsking = false;
  const kept = []; // undo and redo, pressed before the answer
  const done = async (value, isLeft = false) => {
    if (isAsking) return;
    isAsking = true;
    const isTaken = !value || value === name || (await take(value));
    isAsking = false;
    field.ariaInvalid = isTaken ? null : "true";
    if (!isTaken && !isLeft) return kept.splice(0);
    field.onblur = null;
    field.remove();
    if (!isLeft || document.activeElement === document.body) app.drawing.view.focus();
    for (const event of kept) app.drawing.view.dispatchEvent(new KeyboardEvent(event.type, event));
  };
  field.onblur = () => done(field.value.trim(), true);
  field.onkeydown = (event) => {
    event.stopPropagation();
    if (isAsking && (event.ctrlKey || event.metaKey) && /^[zy]$/i.test(event.key)) {
      event.preventDefault();
      kept.push(event);
    }
    if (event.key === "Enter") done(field.value.trim());
    if (event.key === "Escape") done(null);
  };
  app.drawing.view.append(field);
  field.select();
}

export function start(app, { picked, pick, act, say, wire }) {
  const { view, stage, under, choose } = app.drawing;
  const tip = element("output", { class: "why", hidden: true });
  view.append(tip);
  /** A layer above the drawing for what a gesture shows: what lies below is not painted again. @type {SVGElement | null} */
  let layer = null;
  const shape = (tag, attributes) => {
    const made = element(`svg:${tag}`, attributes);
    if (!layer) stage.append((layer = stage.firstElementChild.cloneNode(false)));
    layer.classList.add("over");
    layer.append(made);
    return made;
  };
  let known = null;
  /** Stubs to drag from at outputs that no wire leaves. */
  function offer() {
    known = null;
    const wired = new Set([...stage.querySelectorAll("[data-net]")].map(({ dataset }) => dataset.net.split("[")[0]));
    for (const [name, box] of app.drawing.boxes()) {
      box.querySelectorAll(":scope > .free").forEach((one) => one.remove());
      for (const { port, x, y } of ports(app, name, "out"))
        if (!wired.has(port)) box.append(element("svg:path", { class: "free", d: `M${x} ${y}h6m0 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0` }, element("svg:title", {}, port)));
    }
  }
  app.on("drawn", offer);
  offer();
  /** All ports of the level. */
  const all = () => (known ??= [...app.drawing.boxes().keys()].flatMap((name) => [...ports(app, name, "out"), ...ports(app, name, "in")]));
  /** The port that is nearest to a point, if any is near. */
  const portAt = ([x, y]) => {
    let [best, least] = [null, NEAR / app.drawing.scale()];
    for (const one of all()) {
      const far = Math.hypot(one.x - x, one.y - y);
      if (far < least) [best, least] = [one, far];
    }
    return best;
  };

  // --- moving -------------------------------------------------------------------------------------------------------

  /** Let boxes follow the pointer; wires between them and others are straight until they are dropped. */
  function moving(names) {
    const boxes = names.map((name) => app.drawing.boxes().get(name)).filter(Boolean);
    const isMoved = (end) => names.includes(end.split(/[.[]/)[0]);
    const ends = new Map(all().map((one) => [one.kind + one.port, one]));
    const [along, stretched, group] = [[...boxes], [], shape("g", {})];
    for (const drawn of stage.querySelectorAll("g.wire[data-sink]")) {
      const [from, to] = [isMoved(drawn.dataset.net), isMoved(drawn.dataset.sink)];
      if (from && to) along.push(drawn);
      else if (from || to) {
        const [a, b] = [ends.get(`out${drawn.dataset.net}`), ends.get(`in${drawn.dataset.sink}`)];
        drawn.style.opacity = 0.15;
        if (a && b) stretched.push({ line: shape("path", { class: "rubber" }), a, b, from, to });
      }
    }
    group.append(...along.map((one) => one.cloneNode(true)));
    along.forEach((one) => (one.style.visibility = "hidden"));
    const draw = (dx, dy) => {
      group.setAttribute("transform", `translate(${dx} ${dy})`);
      for (const { line, a, b, from, to } of stretched)
        line.setAttribute("d", `M${a.x + (from ? dx : 0)} ${a.y + (from ? dy : 0)}L${b.x + (to ? dx : 0)} ${b.y + (to ? dy : 0)}`);
    };
    let by = [0, 0];
    return {
      move([x, y], [x0, y0]) {
        by = [Math.round((x - x0) / GRID) * GRID, Math.round((y - y0) / GRID) * GRID];
        draw(...by);
      },
      drop: () => (by[0] || by[1] ? act("place", { names, by }) : app.drawing.show(app.state.level)),
    };
  }

  // --- wires --------------------------------------------------------------------------------------------------------

  /** Draw a wire from a port. from: {port, x, y, kind}; before: the input that its end is taken off. */
  function wiring(from, before = null) {
    const line = shape("path", { class: "rubber" });
    let told = null;
    app.connection.ask("targets", { end: from.port, kind: from.kind, level: app.state.level }).then((answer) => {
      told = answer;
      if (!layer) return;
      for (const one of candidates()) shape("circle", { class: why(one) ? "target" : "target fits", cx: one.x, cy: one.y, r: why(one) ? 3 : 6 });
    }, ({ message }) => say(message));
    const other = from.kind === "out" ? "in" : "out";
    const candidates = () => all().filter(({ kind }) => kind === other);
    const why = ({ port }) => {
      if (!told || port === before) return "";
      const base = port.replace(/\[\d+\]$/, "");
      return [port, base].filter((name) => Object.hasOwn(told.ports, name)).map((name) => told.ports[name])[0] ?? "";
    };
    let met = null;
    /** The port under the pointer; on a block its first one that fits. */
    const find = (at, event) => {
      const near = portAt(at);
      if (near?.kind === other) return near;
      const { box } = under(event.clientX, event.clientY);
      const own = box ? ports(app, box, other) : [];
      return own.find((one) => !why(one)) ?? own[0] ?? null;
    };
    return {
      move(at, _, event) {
        met = find(at, event);
        const [x, y] = met && !why(met) ? [met.x, met.y] : at;
        line.setAttribute("d", `M${from.x} ${from.y}L${x} ${y}`);
        tip.hidden = !(met && why(met));
        tip.textContent = met ? `${met.port} ${why(met)}` : "";
        const around = view.getBoundingClientRect();
        Object.assign(tip.style, { left: `${event.clientX - around.x + 12}px`, top: `${event.clientY - around.y + 12}px` });
      },
      drop(at, event) {
        tip.hidden = true;
        if (met && why(met)) return say(`${met.port} ${why(met)}.`);
        const [source, sink] = from.kind === "out" ? [from.port, met?.port] : [met?.port, from.port];
        if (met && !(before && sink === before)) return wire(source, sink, before);
        if (before && !met) return act("delete", { names: [], sinks: [before] });
        if (!met && under(event.clientX, event.clientY).box === undefined) app.insert("", event, from.kind === "out" ? { source: from.port } : { sink: from.port });
        return null;
      },
    };
  }

  // --- boxes --------------------------------------------------------------------------------------------------------

  function selecting(isMore) {
    const frame = shape("rect", { class: "rubber" });
    let around = null;
    return {
      move([x, y], [x0, y0]) {
        Object.entries({ x: Math.min(x, x0), y: Math.min(y, y0), width: Math.abs(x - x0), height: Math.abs(y - y0) }).forEach(([name, value]) => frame.setAttribute(name, value));
        around = frame.getBoundingClientRect();
      },
      drop() {
        const names = [...app.drawing.boxes()].filter(([, box]) => {
          const { left, right, top, bottom } = box.getBoundingClientRect();
          return left < around.right && right > around.left && top < around.bottom && bottom > around.top;
        });
        pick(names.map(([name]) => name), isMore);
      },
    };
  }

  // --- the pointer --------------------------------------------------------------------------------------------------

  /** Take a press in the drawing: of the main button of a mouse or a pen. */
  app.hand = (down) => {
    if (down.button !== 0 || down.pointerType === "touch" || down.target.closest(".typed")) return false;
    const from = point(app, down);
    const met = under(down.clientX, down.clientY);
    const port = portAt(from);
    const isMore = down.shiftKey || down.ctrlKey || down.metaKey;
    let [gesture, last, frame] = [null, null, 0];
    const begin = () => {
      if (port) {
        const source = port.kind === "in" ? driven(app).get(port.port) : undefined;
        if (source === undefined) return wiring(port);
        const start = all().find((one) => one.kind === "out" && one.port === source);
        return start ? wiring(start, port.port) : wiring(port); // its end is taken off
      }
      if (met.box !== undefined) {
        if (!picked.has(met.box)) pick([met.box], isMore);
        return moving([...picked]);
      }
      return met.net ? wiring({ port: met.net, x: from[0], y: from[1], kind: "out" }) : selecting(isMore);
    };
    const move = (event) => {
      if (event.pointerId !== down.pointerId) return;
      if (!gesture && Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) < LEAST) return;
      if (!gesture) {
        gesture = begin();
        app.hold = true;
        view.setPointerCapture(down.pointerId);
      }
      last = event;
      frame ||= requestAnimationFrame(follow);
    };
    const follow = () => {
      cancelAnimationFrame(frame);
      frame = 0;
      gesture.move(point(app, last), from, last);
    };
    const end = async (event) => {
      if (event.pointerId !== undefined && event.pointerId !== down.pointerId) return;
      off.abort();
      const isDropped = event.type === "pointerup";
      app.hold = false;
      const held = app.held;
      app.held = null;
      if (frame) follow();
      layer?.remove();
      layer = null;
      if (gesture && isDropped) await gesture.drop(point(app, event), event);
      else if (gesture) await app.drawing.show(app.state.level);
      else if (isDropped) isMore && met.box !== undefined ? pick([met.box], true) : met.box !== undefined ? pick([met.box]) : (pick([]), choose(met));
      tip.hidden = true;
      if (held) held();
    };
    const off = new AbortController();
    view.addEventListener("pointermove", move, off);
    view.addEventListener("pointerup", end, off);
    view.addEventListener("pointercancel", end, off);
    document.addEventListener("keydown", (event) => event.key === "Escape" && gesture && end(event), off);
    return true;
  };

  // --- FMUs and Simulink models that are dropped ----------------------------------------------------------------------------------------

  view.ondragover = (event) => event.preventDefault();
  view.ondrop = async (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (!file) return;
    if (file.size > 11e6) return say(`${file.name} is larger than 11 MB: put it into the folder of the diagram, and insert it by its name.`);
    const bytes = new Uint8Array(await file.arrayBuffer());
    const text = btoa(Array.from(bytes, (one) => String.fromCharCode(one)).join(""));
    if (/\.(slx|mdl)$/i.test(file.name)) {
      const made = await app.connection.ask("import_model", { name: file.name, text }).catch(({ message }) => say(message));
      if (!made) return;
      await act("insert", { level: app.state.level, entry: { diagram: made.diagram }, ...near(app, event) });
      return say(made.report);
    }
    const told = await app.connection.ask("upload", { name: file.name, text }).catch(({ message }) => say(message));
    if (!told) return;
    const { box } = under(event.clientX, event.clientY);
    const level = app.state.level;
    const where = box && app.block(app.drawing.full(box)) ? null : near(app, event);
    const take = () => where ? act("insert", { level, entry: { fmu: told.fmu }, ...where }) : act("edit", { level, operations: [{ swap: box, for: { fmu: told.fmu } }], what: `swap ${box}` });
    if (!told.waits) return take();
    say(`${told.fmu} waits for a yes at the terminal where blocks edit runs: an FMU is code.`);
    dropped.set(told.fmu, take);
  };
  /** What is done with an FMU when it may come in. */
  const dropped = new Map();
  app.connection.on("permitted", ({ fmu, why }) => {
    const take = dropped.get(fmu);
    dropped.delete(fmu);
    if (why) say(`${fmu} was not written: ${why}.`);
    else take?.();
  });
}
