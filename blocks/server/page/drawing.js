/** The drawing of the open level, as `blocks draw` makes it: moved, zoomed, searched, with blocks and wires to select. */
import { counted, element, fill } from "./elements.js";

const LEAST = 0.05;
const MOST = 8;
const STEP = 60; // pixels of an arrow key
const REACH = 6; // pixels of the screen from which a wire is met

/** The lines of a drawing, each with all that is inside of its element. */
function pieces(text) {
  const found = [];
  let [depth, piece] = [0, ""];
  for (const line of text.split("\n")) {
    piece += `${line}\n`;
    depth += line.split("<g ").length - line.split("</g>").length;
    if (depth === 0) found.push(piece.slice(0, -1)), (piece = "");
  }
  return found.filter((one) => one && one !== "</svg>");
}

/** The corners of a wire in its drawing, to the tip of its arrow. */
function corners(wire) {
  const [run, head] = ["run", "head"].map((part) => wire.querySelector(`:scope > path.${part}`)?.getAttribute("d") ?? "");
  const places = (text) => [...text.matchAll(/(-?[\d.]+(?:e-?\d+)?)[ ,](-?[\d.]+(?:e-?\d+)?)/g)].map(([, x, y]) => [Number(x), Number(y)]);
  return [...places(run), ...places(head).slice(0, 1)];
}
/** How far a point is from a line through corners. */
function distance([x, y], line) {
  let least = Infinity;
  line.forEach(([x1, y1], k) => {
    const [x0, y0] = line[Math.max(0, k - 1)];
    const [dx, dy] = [x1 - x0, y1 - y0];
    const along = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1), 0), 1);
    least = Math.min(least, Math.hypot(x - x0 - along * dx, y - y0 - along * dy));
  });
  return least;
}

export function start(app) {
  const view = element("div", { id: "view", tabindex: 0, role: "group", "aria-label": "Drawing: arrows move it, plus and minus zoom" });
  const stage = element("div", { id: "stage" });
  const path = element("ol", { class: "path" });
  const button = (label, title, onclick) => element("button", { title, "aria-label": title, onclick }, label);
  const tools = element(
    "div", { class: "tools", role: "toolbar", "aria-label": "View" },
    button("Search", "Search blocks and signals (/)", () => app.search()),
    button("−", "Zoom out (-)", () => zoom(1 / 1.25)),
    button("+", "Zoom in (+)", () => zoom(1.25)),
    button("Fit", "Show all (F)", () => fit()),
    button("?", "Keys (?)", () => app.help()),
  );
  view.append(stage);
  document.getElementById("drawing").append(element("nav", { class: "bar", "aria-label": "Open subdiagram" }, path, tools), view);

  // --- where it is looked at ---
  const at = { x: 0, y: 0, k: 1 };
  const known = new Map(); // by level
  let frame = 0;
  let idle = 0;
  const place = () => {
    frame = 0;
    stage.style.transform = `translate(${at.x}px, ${at.y}px) scale(${at.k})`;
  };
  /** Draw at the next frame; a layer of its own only while it moves, so that it is sharp at rest. */
  const moved = () => {
    frame ||= requestAnimationFrame(place);
    stage.style.willChange = "transform";
    clearTimeout(idle);
    idle = setTimeout(() => (stage.style.willChange = ""), 200);
    at.fitted = false;
    app.emit("view");
  };
  const size = () => {
    const svg = stage.firstElementChild;
    return svg ? [svg.width.baseVal.value, svg.height.baseVal.value] : [1, 1];
  };
  const pan = (dx, dy) => {
    const [width, height] = size();
    const kept = 40; // pixels of the drawing that stay in sight
    at.x = Math.min(Math.max(at.x + dx, kept - width * at.k), view.clientWidth - kept);
    at.y = Math.min(Math.max(at.y + dy, kept - height * at.k), view.clientHeight - kept);
    moved();
  };
  /** Zoom about a point of the view. */
  const zoom = (factor, px = view.clientWidth / 2, py = view.clientHeight / 2) => {
    const k = Math.min(Math.max(at.k * factor, LEAST), MOST);
    at.x = px - ((px - at.x) * k) / at.k;
    at.y = py - ((py - at.y) * k) / at.k;
    at.k = k;
    moved();
  };
  const fit = () => {
    const [width, height] = size();
    at.k = Math.min(Math.max(Math.min(view.clientWidth / width, view.clientHeight / height), LEAST), boxes.size ? 1.6 : 1);
    at.x = (view.clientWidth - width * at.k) / 2;
    at.y = (view.clientHeight - height * at.k) / 2;
    moved();
    at.fitted = true;
  };
  new ResizeObserver(() => at.fitted && fit()).observe(view);

  // --- what is drawn ---
  /** @type {Map<string, Element>} */ let boxes = new Map();
  /** @type {Map<string, Element[]>} */ let nets = new Map();
  const prefix = () => (app.state.level ? `${app.state.level}.` : "");
  const full = (name) => prefix() + name;
  /** What is shown: the text of each element of the drawing, in their order. @type {[string, Element][]} */
  let drawn = [];
  /** Show a text; elements whose texts stay are kept. The policy of the page lets no style sheet stand in a text. */
  const put = (text, isOther) => {
    const [head, style, ...texts] = pieces(text);
    const old = stage.firstElementChild;
    const kept = Map.groupBy(isOther ? [] : drawn, ([piece]) => piece);
    const stay = texts.map((piece) => kept.get(piece)?.shift()?.[1]);
    const made = new DOMParser().parseFromString(`${head}${texts.filter((_, k) => !stay[k]).join("")}</svg>`, "image/svg+xml").documentElement;
    const fresh = [...made.children].values();
    drawn = texts.map((piece, k) => [piece, stay[k] ?? fresh.next().value]);
    if (style !== put.style) {
      const sheet = new CSSStyleSheet();
      sheet.replaceSync((put.style = style).replace(/<.?style>/g, ""));
      document.adoptedStyleSheets = [sheet];
    }
    if (isOther || !old) return stage.replaceChildren(document.adoptNode(made));
    for (const name of new Set([...old.getAttributeNames(), ...made.getAttributeNames()]))
      made.hasAttribute(name) ? old.getAttribute(name) === made.getAttribute(name) || old.setAttribute(name, made.getAttribute(name)) : old.removeAttribute(name);
    fill(old, drawn.map(([, one]) => one));
    for (const [, one] of drawn)
      for (const name of ["style", "transform"]) if (one.hasAttribute(name)) one.removeAttribute(name); // of a drag
  };
  /** From where positions count in what is shown; of a level that was laid out automatically nothing is known. */
  const origin = () => stage.firstElementChild?.dataset.origin?.split(" ").map(Number);
  /** Let what stays in its place stand still on the screen, though the drawing begins elsewhere. @returns {boolean} whether all is in sight */
  const stay = (before) => {
    const now = origin();
    if (!before || !now) return false;
    at.x += (before[0] - now[0]) * at.k;
    at.y += (before[1] - now[1]) * at.k;
    place();
    return [...boxes.values()].every(({ dataset }) => {
      const [x, y] = dataset.at.split(" ").map(Number);
      const [left, top] = [at.x + x * at.k, at.y + y * at.k];
      return left > 0 && top > 0 && left < view.clientWidth && top < view.clientHeight;
    });
  };
  let asked = 0;
  /** Show a level; the view of a level is kept while the page is open. */
  const show = async (level, svg = "") => {
    if (app.hold) return void (app.held = () => show(level)); // a gesture is under way
    const number = ++asked;
    const text = svg || (await app.ask("draw", { level }))?.svg;
    if (number !== asked) return false;
    if (!text) return false;
    const isOther = app.state.level !== level || !stage.firstElementChild;
    if (isOther) {
      if (stage.firstElementChild) known.set(app.state.level, { ...at });
      app.state.level = level;
      app.selectWire(null);
    }
    const before = isOther ? known.get(level) : at;
    const [width, height] = size();
    const began = isOther ? null : boxes.size ? origin() : [0, 0];
    put(text, isOther);
    boxes = new Map(drawn.filter(([, { dataset }]) => dataset.path !== undefined).map(([, box]) => [box.dataset.path, box]));
    lines = null;
    nets = Map.groupBy(stage.querySelectorAll("[data-net]"), (part) => part.dataset.net);
    const isInSight = stay(began);
    if (!before || (before.fitted && !isInSight && (isOther || width !== size()[0] || height !== size()[1]))) fit();
    else if (isOther) Object.assign(at, before), place();
    trail(level);
    mark();
    app.emit("level", level);
    app.emit("drawn", stage.firstElementChild);
    return true;
  };
  const trail = (level) => {
    const steps = level ? level.split(".") : [];
    const crumbs = ["", ...steps].map((name, index) => {
      const to = steps.slice(0, index).join(".");
      const current = index === steps.length ? "page" : null;
      return element("li", {}, element("button", { "aria-current": current, onclick: () => app.open(to) }, name || app.state.document.name));
    });
    path.replaceChildren(...crumbs);
  };
  const mark = () => {
    const { selected, wire } = app.state;
    for (const [name, box] of boxes) box.classList.toggle("selected", full(name) === selected);
    for (const [name, parts] of nets) parts.forEach((part) => part.classList.toggle("selected", full(name) === wire));
  };
  /** Open a subdiagram; "" is the diagram. What was left stays selected. */
  app.open = async (level) => {
    const left = app.state.level;
    if (level === left || !(await show(level))) return;
    if (left.startsWith(level ? `${level}.` : "") && left) app.select(left.split(".").slice(0, level ? level.split(".").length + 1 : 1).join("."));
    else app.select(level || null);
    app.announce(`${level || app.state.document.name}: ${counted(app.state.document.blocks.filter((one) => one.level === level).length, "block")}.`);
  };
  /** Select a block and show it, on its level. */
  app.reveal = async (name) => {
    const block = app.block(name);
    if (!block) return;
    if (block.level !== app.state.level && !(await show(block.level))) return;
    app.select(name);
    const box = boxes.get(name.slice(prefix().length))?.getBoundingClientRect();
    const around = view.getBoundingClientRect();
    if (!box) return;
    const isSeen = box.left > around.left && box.right < around.right && box.top > around.top && box.bottom < around.bottom;
    if (!isSeen) pan((around.left + around.right - box.left - box.right) / 2, (around.top + around.bottom - box.top - box.bottom) / 2);
  };
  const leave = () => app.state.level && app.open(app.state.level.split(".").slice(0, -1).join("."));
  const enter = () => app.block(app.state.selected)?.kind === "diagram" && app.open(app.state.selected);

  // --- by hand ---
  /** What lies under a point of the screen: a block, or the nearest wire. */
  const under = (x, y) => {
    const box = document.elementFromPoint(x, y)?.closest?.("#stage g[data-path]:not(.frame)");
    if (box) return { box: box.dataset.path };
    lines ??= [...stage.querySelectorAll("g.wire[data-net]")].map((wire) => [wire.dataset, corners(wire)]);
    const { left, top } = stage.getBoundingClientRect();
    const point = [(x - left) / at.k, (y - top) / at.k];
    let [nearest, least] = [null, REACH / at.k];
    for (const [wire, line] of lines) {
      const far = distance(point, line);
      if (far < least) [nearest, least] = [wire, far];
    }
    return nearest ? { net: nearest.net, sink: nearest.sink ?? null } : {};
  };
  /** By wire of the level that is shown, its corners. @type {[DOMStringMap, number[][]][] | null} */
  let lines = null;
  let hot = [];
  const hover = ({ box, net }) => {
    hot.forEach((part) => part.classList.remove("hot"));
    hot = box ? [boxes.get(box)] : (nets.get(net) ?? []);
    hot.forEach((part) => part.classList.add("hot"));
    view.style.cursor = hot.length ? "pointer" : "";
  };
  const choose = ({ box, net, sink }) => {
    app.state.sink = sink ?? null;
    const block = box && app.block(full(box));
    const name = net ?? (block ? null : box); // terminals stand for their signals
    // A diagram that has faults has no signals, and its wires are edited.
    const isSignal = name != null && ((net !== undefined && app.key) || app.state.document.signals.some((one) => one.name === full(name)));
    app.selectWire(isSignal ? full(name) : null);
    if (!net) app.select(block ? full(box) : null);
    if (block) app.announce(`${box}, ${block.type}`);
    else if (name != null) app.announce(isSignal ? `signal ${full(name)}` : `${full(name)} is no signal that is recorded: look where it comes from.`);
  };
  const fingers = new Map();
  let travelled = 0;
  view.onpointerdown = (event) => {
    if (event.button > 1 || (fingers.size === 0 && app.hand?.(event))) return;
    fingers.set(event.pointerId, event);
    travelled = fingers.size > 1 ? 99 : 0;
  };
  view.onpointermove = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return event.pointerType === "mouse" && !frame && !app.hold && hover(under(event.clientX, event.clientY));
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const other = [...fingers.values()].find((one) => one.pointerId !== event.pointerId);
    travelled += Math.hypot(dx, dy);
    if (travelled < 4) return;
    view.setPointerCapture(event.pointerId);
    view.classList.add("moving");
    if (other) {
      const around = view.getBoundingClientRect();
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1;
      zoom(apart(event) / apart(before), (event.clientX + other.clientX) / 2 - around.left, (event.clientY + other.clientY) / 2 - around.top);
      pan(dx / 2, dy / 2);
    } else pan(dx, dy);
    fingers.set(event.pointerId, event);
  };
  const lifted = (event) => {
    if (!fingers.delete(event.pointerId)) return;
    view.classList.remove("moving");
    if (event.type === "pointerup" && travelled < 4 && event.button === 0) choose(under(event.clientX, event.clientY));
  };
  view.onpointerup = view.onpointercancel = lifted;
  view.onpointerleave = () => hover({});
  view.ondblclick = (event) => {
    const { box, net } = under(event.clientX, event.clientY);
    if (box) enter() === false && app.values?.();
    else if (net && app.state.wire) app.openScope([app.state.wire]);
    else app.insert ? app.insert("", event) : fit();
  };
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode ? 16 : 1;
    const around = view.getBoundingClientRect();
    if (event.ctrlKey || event.metaKey) zoom(Math.exp((-event.deltaY * lines) / 300), event.clientX - around.left, event.clientY - around.top);
    else if (event.shiftKey && !event.deltaX) pan(-event.deltaY * lines, 0);
    else pan(-event.deltaX * lines, -event.deltaY * lines);
  }, { passive: false });

  // --- by keys ---
  /** The nearest block from the selected one in a direction; without a selection, that at the upper left. */
  const neighbor = (dx, dy) => {
    const centers = [...boxes].filter(([name]) => app.block(full(name))).map(([name, box]) => [name, ...box.dataset.at.split(" ").map(Number)]);
    const from = centers.find(([name]) => full(name) === app.state.selected);
    const rank = ([name, x, y]) => {
      if (!from) return x + y;
      const along = (x - from[1]) * dx + (y - from[2]) * dy;
      return along > 1 && name !== from[0] ? along + 2 * Math.abs((x - from[1]) * dy + (y - from[2]) * dx) : Infinity;
    };
    const ranked = centers.map((one) => [rank(one), one[0]]).filter(([far]) => far < Infinity).sort(([a], [b]) => a - b);
    if (ranked.length) app.reveal(full(ranked[0][1])).then(() => app.announce(`${ranked[0][1]}, ${app.block(full(ranked[0][1])).type}`));
  };
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  view.onkeydown = (event) => {
    const arrow = arrows[event.key];
    if (app.key?.(event, arrow)) return event.preventDefault();
    if (arrow && event.shiftKey) neighbor(...arrow);
    else if (arrow && !event.altKey && !event.ctrlKey) pan(-STEP * arrow[0], -STEP * arrow[1]);
    else if (event.key === "Enter") enter();
    else if (event.key === "Escape") choose({});
    else return;
    event.preventDefault();
  };
  const keys = { "+": () => zoom(1.25), "=": () => zoom(1.25), "-": () => zoom(1 / 1.25), 0: fit, f: fit, Backspace: leave };
  document.addEventListener("keydown", (event) => {
    const action = keys[event.shiftKey ? event.key.toLowerCase() : event.key];
    if (!action || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, textarea, select, dialog, #scopes, #analysis")) return;
    event.preventDefault();
    action();
  });
  app.keys.push(
    ["← ↑ → ↓", "move the drawing (when it has the focus)"], ["+ or -", "zoom; also Ctrl and the wheel, or two fingers"],
    ["F or 0", "show all"], ["Shift+arrow", "to the next block in this direction"],
    ["Enter", "open the selected subdiagram; also a double click"], ["Backspace", "leave the subdiagram"],
  );

  app.on("select", mark);
  app.on("wire", mark);
  app.on("document", (told) => {
    const { svg, level } = app.state;
    app.state.svg = "";
    if (app.state.selected && !app.block(app.state.selected)) app.select(null);
    // A level that is gone is left for the nearest one that is there.
    let open = level;
    while (open && app.block(open)?.kind !== "diagram") open = open.split(".").slice(0, -1).join(".");
    if (told.blocks.length || svg) show(open, open === (told.level ?? "") ? svg : "");
  });
  app.connection.on("drawing", ({ settled, level, svg }) => settled && level === app.state.level && show(level, svg));
  /** What those who change the drawing need of it. */
  app.drawing = { view, stage, under, choose, full, boxes: () => boxes, scale: () => at.k, fit, show, neighbor };
}
