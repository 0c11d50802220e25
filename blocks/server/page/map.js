/** The map of a loop over two parameters: levels of a measure, the region within limits, the best point, a cross to drag. */
import { element, shown, table } from "./elements.js";

const [WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM] = [430, 340, 58, 8, 420, 296];
// How near the cross is taken and does not jump; the part of an axis that an arrow key moves it by; the ratio from which on levels are apart by factors.
const [NEAR, STEP, LARGE] = [16, 0.01, 20];

/** Round numbers between two: by factors of about 2, or by equal steps. */
function rounds(low, high, isByFactors, count) {
  const found = [];
  if (isByFactors) {
    const steps = high / low > 10 ** (count / 2) ? [1] : [1, 2, 5];
    for (let decade = Math.floor(Math.log10(low)); 10 ** decade <= high; decade += 1) found.push(...steps.map((step) => Number(`${step}e${decade}`)));
  } else {
    const size = 10 ** Math.floor(Math.log10((high - low) / count));
    const step = size * ([1, 2, 5].find((one) => (high - low) / (one * size) <= count) ?? 10);
    for (let k = Math.ceil(low / step); k * step <= high; k += 1) found.push(Number((k * step).toPrecision(12)));
  }
  return found.filter((x) => x >= low && x <= high);
}

/** An axis over pixels: by factors where all values are above 0, as the server spaces them. */
function axis(low, high, from, to) {
  const [there, back] = low > 0 ? [Math.log, Math.exp] : [(x) => x, (x) => x];
  const share = (x) => (there(x) - there(low)) / (there(high) - there(low));
  const value = (part) => back(there(low) + Math.min(Math.max(part, 0), 1) * (there(high) - there(low)));
  return { low, high, share, value: (part) => Number(value(part).toPrecision(4)), at: (x) => from + (to - from) * share(x), ticks: rounds(low, high, low > 0 && high / low >= 8, 8) };
}

/** Where a table is at least a level: the area and its border, as paths. Cells without a number are left out. */
function region(rows, level) {
  const [wide, high] = [rows[0].length - 1, rows.length - 1];
  const place = ([i, k]) => `${(LEFT + ((RIGHT - LEFT) * i) / wide).toFixed(1)} ${(BOTTOM - ((BOTTOM - TOP) * k) / high).toFixed(1)}`;
  const outline = (corners) => `M${corners.map(place).join("L")}Z`;
  let [area, line] = ["", ""];
  for (let k = 0; k < high; k += 1) {
    let from = null; // of the cells in a row that lie inside as a whole
    for (let i = 0; i <= wide; i += 1) {
      const corners = [[i, k], [i + 1, k], [i + 1, k + 1], [i, k + 1]];
      const over = corners.map(([a, b]) => (rows[b][a] ?? NaN) - level);
      const isWhole = over.every((one) => one >= 0);
      if (isWhole) from ??= i;
      else if (from !== null) [area, from] = [area + outline([[from, k], [i, k], [i, k + 1], [from, k + 1]]), null];
      if (isWhole || !over.some((one) => one >= 0) || over.some(Number.isNaN)) continue;
      const [points, cuts] = [[], []];
      corners.forEach(([a, b], q) => {
        const next = (q + 1) % 4;
        if (over[q] >= 0) points.push([a, b]);
        if (over[q] >= 0 === over[next] >= 0) return;
        const part = over[q] / (over[q] - over[next]);
        cuts.push([a + part * (corners[next][0] - a), b + part * (corners[next][1] - b)]);
        points.push(cuts.at(-1));
      });
      area += outline(points);
      for (let q = 0; q + 1 < cuts.length; q += 2) line += `M${place(cuts[q])}L${place(cuts[q + 1])}`;
    }
  }
  return { area, line };
}

/** A number of a table between its points; beside a point without one, that of the nearest point. */
function between(rows, u, v) {
  const [wide, high] = [rows[0].length - 1, rows.length - 1];
  const [i, k] = [Math.min(Math.floor(u * wide), wide - 1), Math.min(Math.floor(v * high), high - 1)];
  const [p, q] = [u * wide - i, v * high - k];
  const four = [rows[k][i], rows[k][i + 1], rows[k + 1][i], rows[k + 1][i + 1]];
  if (four.includes(null)) return four[Math.round(p) + 2 * Math.round(q)];
  return (1 - q) * ((1 - p) * four[0] + p * four[1]) + q * ((1 - p) * four[2] + p * four[3]);
}

/** @param {any} app @param {HTMLFormElement} form fields of the loop, its parameters and ranges @param {Function} ask computes the map again */
export function mapOf(app, form, ask) {
  const fields = form.elements;
  const limits = new Map([["Ms", 2]]);
  let [told, axes, tables, number, point, isHeld, shade, best] = [null, null, null, 0, [null, null], false, "Ms", "disturbance"];
  const svg = (tag, attributes, ...children) => element(`svg:${tag}`, attributes, ...children);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plane", role: "group", "aria-label": "Map of the loop" });
  const [under, over] = [svg("g", {}), svg("g", {})];
  const cross = svg("g", { class: "cross", tabindex: 0, role: "slider", "aria-label": "Point of the map", hidden: true },
    svg("circle", { r: NEAR }), svg("path", { d: "M-8 -8L8 8M-8 8L8 -8" }));
  const hatch = (id, d) => svg("pattern", { id, width: 7, height: 7, patternUnits: "userSpaceOnUse" }, svg("path", { d, class: "hatch" }));
  picture.append(svg("defs", {}, hatch("unstable", "M0 7L7 0M-1 1L1 -1M6 8L8 6")), under, over, cross);
  const [words, readings, errors] = [element("output", { class: "point" }), element("div", {}), element("div", { class: "error", role: "alert" })];
  const legend = element("ul", { class: "legend", "aria-label": "Legend" });
  const root = element("div", { class: "map" }, picture, element("div", { class: "readings" }, words, errors, legend, readings));

  // --- what is asked ---
  for (const one of ["x", "y"]) fields[one].addEventListener("change", () => (fields[`${one}0`].value = fields[`${one}1`].value = ""), true);
  function given() {
    const ranges = ["x", "y"].filter((one) => fields[one].value).map((one) => {
      const ends = [fields[`${one}0`], fields[`${one}1`]].map((field) => field.valueAsNumber);
      return [fields[one].value, ends.some(Number.isNaN) ? [] : ends];
    });
    return { control: fields.control.value, output: fields.output.value, over: Object.fromEntries(ranges), limits: Object.fromEntries(limits), best, near: app.state.wire ?? app.state.selected ?? "", have: number };
  }

  // --- what comes back ---
  /** Take an answer of the server over. */
  function show(answer) {
    const { map } = answer;
    const names = Object.keys(map.over);
    const isOther = !told || JSON.stringify([told.map.over, told.map.control]) !== JSON.stringify([map.over, map.control]);
    told = answer.number === undefined ? null : answer;
    root.hidden = !told;
    [fields.control.value, fields.output.value, fields.x.value, fields.y.value] = [map.control, map.output, ...names];
    names.forEach((name, k) => [0, 1].forEach((end) => (fields[`${"xy"[k]}${end}`].value = map.over[name][end])));
    if (!told) return;
    if (answer.tables) [tables, number] = [Object.fromEntries(map.measures.map(([name], k) => [name, answer.tables[k]])), answer.number];
    const ranges = Object.values(map.over);
    axes = [axis(...ranges[0], LEFT, RIGHT), axis(...ranges[1], BOTTOM, TOP)];
    if (!isHeld) point = map.present.map(({ value }) => (typeof value === "number" ? value : null));
    if (answer.tables || isOther) draw();
    bound();
  }
  const label = ({ name, unit }) => `${name}${unit ? ` [${unit}]` : ""}`;
  const measure = (name) => told.map.measures.find(([one]) => one === name);
  /** The levels of the measure, and the axes. */
  function draw() {
    const [x, y] = axes;
    const parts = [svg("rect", { x: LEFT, y: TOP, width: RIGHT - LEFT, height: BOTTOM - TOP, fill: "url(#unstable)" })];
    parts.push(svg("path", { d: region(tables.Ms, -Infinity).area, class: "stable" }));
    const known = tables[shade].flat().filter((one) => one !== null).toSorted((a, b) => a - b);
    const [low, high] = [known[Math.floor(0.04 * known.length)], known[Math.floor(0.9 * known.length)]]; // lines crowd at the border of stability
    const labels = [];
    for (const level of low < high ? rounds(low, high, low > 0 && high / low > LARGE, 8) : []) {
      const { area, line } = region(tables[shade], level);
      parts.push(svg("path", { d: area, class: "level" }), svg("path", { d: line, class: "line" }));
      const places = [...line.matchAll(/M(\S+) (\S+)L/g)].map(([, a, b]) => [Number(a), Number(b)]).filter(([a, b]) => a > LEFT + 20 && a < RIGHT - 20 && b > TOP + 12 && b < BOTTOM - 12);
      const middle = places.toSorted((one, other) => Math.abs(one[0] - one[1] - LEFT) - Math.abs(other[0] - other[1] - LEFT)).find(([a, b]) => labels.every(([c, d]) => Math.abs(a - c) > 34 || Math.abs(b - d) > 14));
      if (middle) labels.push([...middle, shown(level, 3)]);
    }
    parts.push(...labels.map(([a, b, text]) => svg("text", { x: a, y: b + 4, class: "label" }, text)));
    parts.push(...x.ticks.flatMap((one) => [svg("path", { d: `M${x.at(one)} ${BOTTOM}v5`, class: "tick" }), svg("text", { x: x.at(one), y: BOTTOM + 18, class: "x" }, shown(one, 4))]));
    parts.push(...y.ticks.flatMap((one) => [svg("path", { d: `M${LEFT} ${y.at(one)}h-5`, class: "tick" }), svg("text", { x: LEFT - 8, y: y.at(one) + 4, class: "y" }, shown(one, 4))]));
    parts.push(svg("text", { x: (LEFT + RIGHT) / 2, y: HEIGHT - 6, class: "x" }, label(told.map.present[0])), svg("text", { transform: `translate(12 ${(TOP + BOTTOM) / 2}) rotate(-90)`, class: "x" }, label(told.map.present[1])));
    under.replaceChildren(...parts);
  }
  /** The region outside of the limits, its border, the best point, and the frame. */
  function bound() {
    const [x, y] = axes;
    const within = region(told.slack, 0);
    const parts = [svg("path", { d: region(told.slack.map((row) => row.map((one) => -one)), 1e-12).area, class: "outside" }), svg("path", { d: within.line, class: "border" })];
    if (told.best) parts.push(svg("path", { class: "best", d: "M0 -9L2.6 -2.8L9 -2.8L3.9 1.3L5.6 8L0 4L-5.6 8L-3.9 1.3L-9 -2.8L-2.6 -2.8Z", transform: `translate(${x.at(told.best.point[0])} ${y.at(told.best.point[1])})` }));
    parts.push(svg("rect", { x: LEFT, y: TOP, width: RIGHT - LEFT, height: BOTTOM - TOP, class: "frame" }));
    over.replaceChildren(...parts);
    const said = [...limits].map(([name, end]) => `${name} ${measure(name)[2] ? "≥" : "≤"} ${shown(end)}`).join(", ");
    const entry = (name, text) => element("li", { class: name }, text);
    legend.replaceChildren(entry("cross", "present values: drag the cross, or move it with the arrow keys"), ...(told.best ? [entry("best", `${measure(best)[2] ? "largest" : "least"} ${best} within the limits`)] : []),
      ...(said ? [entry("outside", `outside of ${said}`)] : []), ...(tables.Ms.flat().includes(null) ? [entry("unstable", "not stable")] : []), entry("line", `${measure(shade)[1]}: the stronger, the larger`));
    if (!readings.firstChild) readings.append(measures());
    told.map.measures.forEach(([name], k) => (readings.querySelector(`[data-best="${name}"]`).textContent = told.best ? read_(told.best.at[k], name) : "-"));
    read();
  }
  /** A row for each measure: at the cross, at the best point, its limit; which one is shaded, and which is best at the star. */
  function measures() {
    const radio = (group, name, label_, isOn, act) => Object.assign(element("input", { type: "radio", name: group, "aria-label": label_, onchange: act }), { checked: isOn });
    const rows = told.map.measures.map(([name, text, isLeast]) => {
      const limit = element("input", { type: "number", step: "any", class: "short", "aria-label": `${isLeast ? "least" : "largest"} ${text}`, onchange: () => {
        if (Number.isNaN(limit.valueAsNumber)) limits.delete(name);
        else limits.set(name, limit.valueAsNumber);
        ask();
      } });
      limit.value = String(limits.get(name) ?? "");
      const star = radio("map-best", name, `best: ${isLeast ? "largest" : "least"} ${text}`, best === name, () => ask((best = name)));
      return [text, radio("map-shade", name, `shade ${text}`, shade === name, () => [(shade = name), draw(), bound()]), element("output", { "data-of": name }), element("output", { "data-best": name }), element("label", {}, isLeast ? "≥ " : "≤ ", limit), star];
    });
    return table(["measure", "shade", "at ✕", "at ★", "limit", "★"], rows);
  }
  const isStable = () => isInside() && between(tables.Ms, ...shares()) !== null;
  const read_ = (x, name) => (x === null ? (name === "Ms" ? "-" : "none") : shown(x, 4));
  const shares = () => axes.map(({ share }, k) => share(point[k]));
  const isInside = () => point.every((one, k) => one !== null && one >= axes[k].low && one <= axes[k].high);
  /** Show where the cross is, and what the loop measures there. */
  function read() {
    const isSeen = isInside();
    cross.toggleAttribute("hidden", !isSeen);
    const text = told.map.present.map(({ name, unit }, k) => `${name} = ${shown(point[k], 4)}${unit ? ` ${unit}` : ""}`).join(", ");
    words.textContent = isSeen ? `${text}${isStable() ? "" : ": not stable"}` : `${text}: outside of the map; a click brings it here.`;
    if (isSeen) cross.setAttribute("transform", `translate(${axes[0].at(point[0])} ${axes[1].at(point[1])})`);
    for (const one of readings.querySelectorAll("[data-of]")) one.textContent = isStable() ? read_(between(tables[one.dataset.of], ...shares()), one.dataset.of) : "-";
    const here = ["Ms", shade, "disturbance"].filter((name, k, all) => all.indexOf(name) === k).map((name) => `${measure(name)[1]} ${readings.querySelector(`[data-of="${name}"]`)?.textContent ?? ""}`);
    if (isSeen) cross.setAttribute("aria-valuenow", shown(100 * shares()[0], 3));
    cross.setAttribute("aria-valuetext", [words.textContent, ...(isSeen ? here : [])].join(", "));
  }

  // --- the cross ---
  const moved = new Set(); // parameters, since the cross was taken
  /** Set what moved, at once in a run; isLast: where it is edited, write it as one step. */
  function move(to, isLast) {
    told.map.present.forEach(({ name }, k) => to[k] !== point[k] && moved.add(name));
    point = to;
    read();
    app.turnAll(told.map.present.map(({ name }, k) => [name, point[k]]).filter(([name]) => moved.has(name)), refused, isLast);
    if (isLast) moved.clear();
  }
  const known = new Map(); // what is refused, by parameter
  const refused = (name) => ({ refuse(...text) {
    known.set(name, text.length ? element("p", {}, `${name}: `, ...text) : null);
    errors.replaceChildren(...[...known.values()].filter(Boolean));
  } });
  picture.onpointerdown = (down) => {
    if (!told || down.button) return;
    const inside = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(picture.getScreenCTM().inverse());
    const { x, y } = inside(down);
    if (x < LEFT - NEAR || x > RIGHT + NEAR || y < TOP - NEAR || y > BOTTOM + NEAR) return;
    const off = isInside() ? [axes[0].at(point[0]) - x, axes[1].at(point[1]) - y] : [Infinity, Infinity];
    const isTaken = Math.hypot(...off) < NEAR;
    const [dx, dy] = isTaken ? off : [0, 0];
    const to = (event, isLast) => {
      const at = inside(event);
      move([axes[0].value((at.x + dx - LEFT) / (RIGHT - LEFT)), axes[1].value((at.y + dy - BOTTOM) / (TOP - BOTTOM))], isLast);
    };
    let hasMoved = !isTaken;
    isHeld = true;
    picture.setPointerCapture(down.pointerId);
    cross.focus();
    if (hasMoved) to(down, false);
    picture.onpointermove = (event) => to(event, (hasMoved = true) && false);
    picture.onpointerup = picture.onpointercancel = (event) => {
      picture.onpointermove = picture.onpointerup = picture.onpointercancel = null;
      isHeld = false;
      if (hasMoved && event.type === "pointerup") to(event, true);
      else if (hasMoved) move(point, true); // where a cancelled pointer is, is not known
    };
    down.preventDefault();
  };
  let isTurned = false;
  cross.onkeydown = (event) => {
    const [along, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!along && !up) return;
    event.preventDefault();
    const step = STEP * (event.shiftKey ? 10 : 1);
    const [u, v] = shares();
    [isHeld, isTurned] = [true, true];
    move([along ? axes[0].value(u + along * step) : point[0], up ? axes[1].value(v + up * step) : point[1]], false);
  };
  cross.onkeyup = cross.onblur = () => {
    isHeld = false;
    if (isTurned) move(point, true);
    isTurned = false;
  };
  return { root, given, show, get isHeld() { return isHeld; } };
}
