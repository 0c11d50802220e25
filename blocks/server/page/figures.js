/** Figures of a report that zoom: a button shows their rows in place of the picture, which is what prints. */
import uPlot from "./vendor/uplot.js";

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** One panel as a plot. */
function plotted(panel, figure, place) {
  const tables = panel.groups.map(({ t, values, lines }) => {
    const x = new Float64Array(bytes(t));
    const all = new Float32Array(bytes(values));
    return [x, ...lines.map((_, k) => all.subarray(k * x.length, (k + 1) * x.length))];
  });
  const series = panel.groups.flatMap(({ lines }) =>
    lines.map(({ label, style, dash, points }) => {
      const stroke = color(style === null ? "--ink" : `--c${style % 6}`);
      return { label, stroke, dash, width: 1.5, spanGaps: true, points: { show: points, size: 8 }, paths: points ? () => null : undefined };
    }),
  );
  const axis = { stroke: color("--ink"), grid: { stroke: color("--line"), width: 0.5 }, ticks: { stroke: color("--line") } };
  const band = (u) => {
    if (!panel.band) return;
    const [from, to] = panel.band.map((x) => Math.min(Math.max(u.valToPos(x, "x", true), u.bbox.left), u.bbox.left + u.bbox.width));
    u.ctx.fillStyle = "rgba(148, 163, 184, 0.22)";
    u.ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
  };
  const options = {
    width: place.clientWidth, height: 60 + 170 * panel.height, cursor: { sync: { key: figure.name, scales: ["x", null] } },
    scales: { x: { time: false }, y: { distr: panel.log ? 3 : 1 } }, series: [{ label: figure.along }, ...series],
    axes: [{ ...axis, label: figure.along }, { ...axis, label: panel.ylabel, size: 70 }], hooks: { drawClear: [band] },
  };
  return new uPlot(options, tables.length > 1 ? uPlot.join(tables) : tables[0], place);
}

/** Keys of a focused figure: + and - zoom, arrows move, 0 shows all. */
function turned(key, plots) {
  const { min, max } = plots[0].scales.x;
  const xs = plots[0].data[0];
  const part = { "+": [0.25, -0.25], "-": [-0.5, 0.5], ArrowLeft: [-0.2, -0.2], ArrowRight: [0.2, 0.2] }[key];
  if (!part && key !== "0") return false;
  const [low, high] = part ? [min + part[0] * (max - min), max + part[1] * (max - min)] : [xs[0], xs[xs.length - 1]];
  plots.forEach((plot) => plot.setScale("x", { min: low, max: high }));
  return true;
}

for (const figure of JSON.parse(document.getElementById("zoom").textContent)) {
  const place = [...document.querySelectorAll("figure")].find((one) => one.dataset.figure === figure.name);
  const picture = place?.querySelector(".plot");
  if (!picture) continue;
  const button = document.createElement("button");
  button.textContent = "Zoom";
  let shown = null;
  button.onclick = () => {
    shown?.remove();
    shown = shown ? null : document.createElement("div");
    button.textContent = shown ? "As printed" : "Zoom";
    picture.classList.toggle("in-print", Boolean(shown));
    if (!shown) return;
    Object.assign(shown, { className: "zoomed", tabIndex: 0, role: "group", ariaLabel: `${figure.name}: ${figure.told}` });
    picture.before(shown);
    const plots = figure.panels.map((panel) => plotted(panel, figure, shown));
    shown.append(Object.assign(document.createElement("p"), { className: "source", textContent: figure.told }));
    shown.onkeydown = (event) => void (turned(event.key, plots) && event.preventDefault());
  };
  picture.before(button);
}
