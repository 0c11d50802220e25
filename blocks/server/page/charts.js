/** Small charts in SVG, with a logarithmic or a linear axis each, a mark to move along the curve, and a name for who hears. */
const SVG = "http://www.w3.org/2000/svg";
const [LEFT, RIGHT, TOP] = [48, 16, 18]; // pixels around the plot

export function part(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, String(value));
  made.append(...children);
  return made;
}

export const short = (value) => (value == null || !Number.isFinite(value) ? "-" : String(+value.toPrecision(4)));

/** Round values in a range; whole: degrees go by 45 or 90. */
function ticks([low, high], { log = false, whole = 0 }, count) {
  if (log) {
    const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
    const every = Math.ceil((last - first + 1) / 7);
    return Array.from({ length: Math.floor((last - first) / every) + 1 }, (_, k) => 10 ** (first + k * every));
  }
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  let step = [1, 2, 5, 10].find((one) => one * power >= rough) * power;
  if (whole) step = [5, 15, 30, 45, 90, 180, 360, 720].find((one) => one >= rough) ?? 1440;
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1) }, (_, k) => (first + k) * step);
}

/**
 * A chart of curves.
 * @param {{name: string, width: number, height: number, x: any, y: any, curves: {x: number[], y: number[], style?: string}[],
 *   marks?: {x: number, y: number, text: string, to?: number}[], circles?: number[][], told: (k: number) => string, isSquare?: boolean}} chart
 *   x, y: {label, range, log, whole}. curves: the first is the one that the mark moves along; told: its words there.
 */
export function chart({ name, width, height, x, y, curves, marks = [], circles = [], told, announce, isSquare = false }) {
  const bottom = x.label ? 32 : 18;
  const [w, h] = [width - LEFT - RIGHT, height - TOP - bottom];
  if (isSquare) { // one length of both axes
    const unit = Math.max((x.range[1] - x.range[0]) / w, (y.range[1] - y.range[0]) / h);
    for (const [axis, pixels] of [[x, w], [y, h]]) {
      const middle = (axis.range[0] + axis.range[1]) / 2;
      axis.range = [middle - (unit * pixels) / 2, middle + (unit * pixels) / 2];
    }
  }
  const part_ = (axis, value) => {
    const [low, high] = axis.log ? axis.range.map(Math.log) : axis.range;
    return ((axis.log ? Math.log(value) : value) - low) / (high - low);
  };
  const px = (value) => LEFT + w * part_(x, value);
  const py = (value) => TOP + h * (1 - Math.min(Math.max(part_(y, value), -20), 20));
  const root = part("svg", { class: "chart", width, height, viewBox: `0 0 ${width} ${height}`, role: "img", tabindex: 0, "aria-label": `${name}. Arrow keys move along the curve.` });
  const clip = `clip-${Math.random().toString(36).slice(2)}`;
  root.append(part("clipPath", { id: clip }, part("rect", { x: LEFT, y: TOP, width: w, height: h })));
  for (const value of ticks(x.range, x, 5)) {
    root.append(part("line", { class: "grid", x1: px(value), x2: px(value), y1: TOP, y2: TOP + h }));
    root.append(part("text", { class: "tick", x: px(value), y: TOP + h + 13, "text-anchor": "middle" }, short(value)));
  }
  for (const value of ticks(y.range, y, Math.max(2, h / 34))) {
    root.append(part("line", { class: "grid", x1: LEFT, x2: LEFT + w, y1: py(value), y2: py(value) }));
    root.append(part("text", { class: "tick", x: LEFT - 5, y: py(value) + 4, "text-anchor": "end" }, short(value)));
  }
  root.append(part("text", { class: "label", x: LEFT + w / 2, y: height - 5, "text-anchor": "middle" }, x.label));
  root.append(part("text", { class: "label", x: 4, y: 12 }, y.label));
  const inner = part("g", { "clip-path": `url(#${clip})` });
  for (const [a, b, r] of circles) inner.append(part("ellipse", { class: "unit-circle", cx: px(a), cy: py(b), rx: px(a + r) - px(a), ry: py(b) - py(b + r) }));
  for (const { x: xs, y: ys, style = "" } of curves.toReversed()) {
    let path = "";
    let isOn = false;
    xs.forEach((value, k) => {
      const isNumber = ys[k] !== null && Number.isFinite(value) && Number.isFinite(ys[k]);
      if (isNumber) path += `${isOn ? "L" : "M"}${px(value).toFixed(1)} ${py(ys[k]).toFixed(1)}`;
      isOn = isNumber;
    });
    inner.append(part("path", { class: `curve ${style}`, d: path }));
  }
  for (const { x: a, y: b, text, to } of marks) {
    if (to !== undefined) inner.append(part("line", { class: "margin", x1: px(a), x2: px(a), y1: py(b), y2: py(to) }));
    inner.append(part("circle", { class: "mark", cx: px(a), cy: py(b), r: 3.5 }, part("title", {}, text)));
    const isLate = isSquare || px(a) > LEFT + 0.7 * w;
    inner.append(part("text", { class: "mark", x: px(a) + (isLate ? -7 : 7), y: Math.max(py(b) - 6, TOP + 10), "text-anchor": isLate ? "end" : "start" }, text));
  }
  const dot = part("circle", { class: "dot", r: 4, visibility: "hidden" });
  const words = part("text", { class: "words", x: LEFT + w, y: 12, "text-anchor": "end" });
  root.append(inner, dot, words);
  const [first] = curves;
  let at = -1;
  const point = (k) => {
    at = Math.min(Math.max(k, 0), first.x.length - 1);
    dot.setAttribute("cx", px(first.x[at]));
    dot.setAttribute("cy", py(first.y[at]));
    dot.setAttribute("visibility", "visible");
    words.textContent = told(at);
  };
  root.onpointermove = ({ offsetX, offsetY }) => {
    const far = first.x.map((value, k) => (isSquare ? Math.hypot(px(value) - offsetX, py(first.y[k]) - offsetY) : Math.abs(px(value) - offsetX)));
    point(far.indexOf(Math.min(...far)));
  };
  root.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1, PageDown: 20, PageUp: -20, Home: -1e9, End: 1e9 }[event.key];
    if (!step) return;
    event.preventDefault();
    point(at < 0 ? first.x.length >> 1 : at + step);
    announce(told(at));
  };
  return root;
}
