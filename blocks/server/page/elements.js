/** What the parts of the page are made of. */

/** An element with attributes, and with children: elements or texts. One of SVG is named so: "svg:path". */
export function element(tag, attributes = {}, ...children) {
  const made = tag.startsWith("svg:") ? document.createElementNS("http://www.w3.org/2000/svg", tag.slice(4)) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made[name] = (event) => void value(event); // who returns false takes the event away
    else if (value !== null && value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** Give a place these children; those that stay are not taken out meanwhile, and keep the focus. */
export function fill(place, children) {
  const stay = new Set(children);
  [...place.childNodes].forEach((one) => stay.has(one) || one.remove());
  let next = place.firstChild;
  for (const one of children) one === next ? (next = next.nextSibling) : place.insertBefore(one, next);
}

/** What gives for equal keys the element that it gave in the round before. `round()` begins the next one. */
export function keeper() {
  let [known, now] = [new Map(), new Map()];
  const keep = (key, make) => {
    const name = JSON.stringify(key);
    const one = (!now.has(name) && known.get(name)) || make();
    now.set(name, one);
    return one;
  };
  keep.round = () => ([known, now] = [now, new Map()]);
  return keep;
}

/** By control, the value that it was given, or that was taken from it: a person typed what differs from it. */
const given = new WeakMap();
export const valueOf = (control) => (control.type === "checkbox" ? control.checked : control.value);
export const isTyped = (control) => given.has(control) && valueOf(control) !== given.get(control);
/** Count the value of a control as no longer typed. */
export const settle = (control) => void given.set(control, valueOf(control));
/** Let a control show a value. */
export function give(control, value) {
  if (control.type === "checkbox") control.checked = value === true;
  else control.value = value;
  settle(control);
}

let isPressed = false;
const waiting = new Map();
const lifted = ({ type, buttons }) => {
  if (!isPressed || (type === "pointermove" && buttons)) return;
  isPressed = false;
  setTimeout(() => [...waiting].forEach(([name, act]) => waiting.delete(name) && act())); // after the click
};
addEventListener("pointerdown", () => (isPressed = true), true);
for (const name of ["pointerup", "pointercancel", "pointermove"]) addEventListener(name, lifted, true);
/** Show something anew, but not under a pressed pointer, whose click would be lost. Of each name the last one waits. */
export const anew = (name, act) => void (isPressed ? waiting.set(name, act) : act());

/** A dialog that closes by Escape and by a click beside it, and gives the focus back. */
export function dialog(label, ...children) {
  const made = element("dialog", { "aria-label": label }, ...children);
  const back = document.activeElement;
  made.onclick = (event) => void (event.target === made && made.close());
  made.onclose = () => {
    made.remove();
    if (document.activeElement === document.body) back?.focus();
  };
  document.body.append(made);
  made.showModal();
  return made;
}

/** A fault, as the server tells it. */
export const fault = ({ code, place, message, cure, warning }) =>
  element("p", { class: warning ? "warning" : "fault" }, element("b", {}, code), ` ${place}: ${message} ${cure}`);

/** A table. head: may be empty; the first cell of a row names it. */
export const table = (head, rows) =>
  element("table", {},
    head.length ? element("thead", {}, element("tr", {}, ...head.map((text) => element("th", { scope: "col" }, text)))) : null,
    element("tbody", {}, ...rows.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, first), ...rest.map((text) => element("td", {}, text))))));

/** "1 fault", "2 faults". */
export const counted = (count, noun) => `${count === 0 ? "no" : count} ${noun}${count === 1 ? "" : "s"}`;

/** HTML that the server has made and escaped, as nodes. @param {string} html */
export function trusted(html) {
  const nodes = new DOMParser().parseFromString(html, "text/html").body.childNodes;
  return [...nodes].map((node) => document.adoptNode(node));
}

/** A number as people read it; of a list, each. @param {any} x */
export function shown(x, digits = 6) {
  if (Array.isArray(x)) return `[${x.map((one) => shown(one, digits)).join(", ")}]`;
  if (typeof x !== "number") return String(x ?? "");
  const isFar = x !== 0 && (Math.abs(x) >= 1e6 || Math.abs(x) < 1e-4);
  return isFar ? x.toExponential(digits - 1).replace(/\.?0+e/, "e") : String(Number(x.toPrecision(digits)));
}

/** A time, with the digits that a part of the span around it takes. */
export function seconds(t, [t0, t1], least = 8) {
  const digits = 5 + Math.log10(Math.max(Math.abs(t0), Math.abs(t1)) / (t1 - t0));
  const most = Math.min(Math.max(Math.ceil(digits), least), 17); // a span of 0 has none
  return `${+t.toPrecision(most || least)} s`;
}
