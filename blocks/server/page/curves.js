/** Curves of scopes: rows as they come in frames, and how they are drawn on a canvas. */

/** The first index from which on times are at least x, or larger. */
function search(t, x, isLarger = false) {
  let [low, high] = [0, t.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] < x || (isLarger && t[middle] === x)) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The columns of a frame over their times. */
export class Curve {
  constructor({ header = {}, t, columns }) {
    Object.assign(this, { header, t, columns });
  }

  /** The last time; -Infinity where there is none. */
  get last() {
    return this.t.at(-1) ?? -Infinity;
  }

  /** The rows between two times. more: with so many on both sides, to which lines lead. */
  rows(t0, t1, more = 0) {
    return [Math.max(0, search(this.t, t0) - more), Math.min(this.t.length, search(this.t, t1, true) + more)];
  }

  /** Least, largest and last finite value of a column between two times, or of so many more rows. */
  range(column, t0, t1, more = 0) {
    const values = this.columns[column];
    const [first, end] = this.rows(t0, t1, more);
    let [low, high, last] = [Infinity, -Infinity, null];
    for (let i = first; i < end; i += 1) {
      const value = values[i];
      if (value - value !== 0) continue; // NaN or infinite
      if (value < low) low = value;
      if (value > high) high = value;
      last = value;
    }
    return [low, high, last];
  }
}

/** Where times and values lie on the canvas. u: the plot; scale: that of the values. */
function places({ bbox, scales }, scale) {
  const { min: t0, max: t1 } = scales.x;
  const [kx, ky, base] = [bbox.width / (t1 - t0), bbox.height / (scale.max - scale.min), bbox.top + bbox.height];
  return { t0, t1, x: (t) => bbox.left + (t - t0) * kx, y: (value) => base - (value - scale.min) * ky };
}

/** Draw a column as a line, with a gap where it has no finite value. dots: a mark at each row, where they are few. */
export function drawLine(u, scale, curve, column, { color, dash = [], width = 1, alpha = 1, dots = false }) {
  const { t0, t1, x: across, y: up } = places(u, scale);
  const [first, end] = curve.rows(t0, t1, 1);
  const { ctx, bbox } = u;
  const [ratio, values, path] = [devicePixelRatio, curve.columns[column], new Path2D()];
  let [isDown, travelled, wasX, wasY] = [false, 0, 0, 0];
  for (let i = first; i < end; i += 1) {
    const [x, y] = [across(curve.t[i]), up(values[i])];
    // What moves by less than half a pixel is not seen, and would take its time.
    if (isDown && i + 1 < end && Math.abs(x - wasX) < 0.75 && Math.abs(y - wasY) < 0.5) continue;
    const wasDown = isDown;
    isDown = y - y === 0;
    if (!isDown) continue;
    if (wasDown) travelled += Math.abs(y - wasY);
    path[wasDown ? "lineTo" : "moveTo"](x, y);
    [wasX, wasY] = [x, y];
    // The only row, or one between gaps, is seen as well.
    if (!wasDown && (i + 1 === end || values[i + 1] - values[i + 1] !== 0)) path.rect(x - ratio, y - ratio, 2 * ratio, 2 * ratio);
    if (!dots || end - first >= bbox.width / 8) continue;
    path.rect(x - ratio, y - ratio, 2 * ratio, 2 * ratio);
    path.moveTo(x, y);
  }
  Object.assign(ctx, { strokeStyle: color, lineWidth: width * ratio, globalAlpha: alpha, lineJoin: "round" });
  // Where a line fills its area, a dash would not be seen and takes the time of ten lines.
  ctx.setLineDash(travelled > 20 * bbox.height ? [] : dash.map((length) => length * ratio));
  ctx.stroke(path);
}

/** Draw the outer quantiles of a sweep as an area, and the middle one as a thin line. */
export function drawBand(u, scale, curve, color) {
  const { x, y } = places(u, scale);
  const path = new Path2D();
  const trace = (column, i) => Number.isFinite(column[i]) && path.lineTo(x(curve.t[i]), y(column[i]));
  for (let i = 0; i < curve.t.length; i += 1) trace(curve.columns[0], i);
  for (let i = curve.t.length - 1; i >= 0; i -= 1) trace(curve.columns.at(-1), i);
  Object.assign(u.ctx, { fillStyle: color, globalAlpha: 0.2 });
  u.ctx.fill(path);
  drawLine(u, scale, curve, curve.columns.length >> 1, { color, alpha: 0.6 });
}

/** Draw events: marks that hang from the upper edge. */
export function drawMarks(u, curve, color) {
  const { t0, t1, x } = places(u, u.scales.x);
  const [first, end] = curve.rows(t0, t1);
  Object.assign(u.ctx, { fillStyle: color, globalAlpha: 1 });
  for (let i = first; i < end; i += 1) u.ctx.fillRect(x(curve.t[i]) - devicePixelRatio / 2, u.bbox.top, devicePixelRatio, 8 * devicePixelRatio);
}
