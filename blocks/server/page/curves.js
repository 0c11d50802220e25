/** Curves of scopes: rows as they come in frames, and how they are drawn on a canvas. */

/** The first index from which on times are at least x, or larger. */
function search(t, count, x, isLarger = false) {
  let [low, high] = [0, count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] < x || (isLarger && t[middle] === x)) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Times and columns that grow; rows that an append brings again are replaced. */
export class Curve {
  constructor() {
    this.header = { signals: [] };
    this.t = new Float64Array(0);
    /** @type {Float32Array[]} */
    this.columns = [];
    this.count = 0;
    this.lost = 0; // rows at the beginning that were let go
  }

  /** The last time; -Infinity where there is none. */
  get last() {
    return this.count ? this.t[this.count - 1] : -Infinity;
  }

  /** Take a frame; rows before `since` are let go when they are many. */
  take({ header, t, columns }, since) {
    if (header.kind !== "append") this.lost = 0;
    const from = header.kind === "append" ? Math.max(0, header.from - this.lost) : 0;
    this.header = header;
    this.count = from + t.length;
    if (this.count > this.t.length || this.columns.length !== columns.length) {
      const larger = (old, made) => (old && made.set(old.subarray(0, from)), made);
      this.t = larger(this.t, new Float64Array(2 * this.count));
      this.columns = columns.map((_, k) => larger(this.columns[k], new Float32Array(2 * this.count)));
    }
    this.t.set(t, from);
    columns.forEach((column, k) => this.columns[k].set(column, from));
    const gone = search(this.t, this.count, since);
    if (gone < 8192 || gone < this.count / 2) return;
    for (const array of [this.t, ...this.columns]) array.copyWithin(0, gone, this.count);
    this.count -= gone;
    this.lost += gone;
  }

  /** The rows between two times. within: without those to which lines lead on both sides. */
  rows(t0, t1, within = false) {
    const more = within ? 0 : 1;
    return [Math.max(0, search(this.t, this.count, t0) - more), Math.min(this.count, search(this.t, this.count, t1, true) + more)];
  }

  /** Least, largest and last finite value of a column between two times. */
  range(column, t0, t1, within = false) {
    const values = this.columns[column];
    const [first, end] = this.rows(t0, t1, within);
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

  /** The value of a column at a time, on the line between its rows; null outside. */
  at(column, t) {
    const [after, values] = [search(this.t, this.count, t, true), this.columns[column]];
    if (after && this.t[after - 1] === t) return values[after - 1];
    if (after === 0 || after === this.count) return null;
    const share = (t - this.t[after - 1]) / (this.t[after] - this.t[after - 1]);
    return (1 - share) * values[after - 1] + share * values[after];
  }

  /** Of events: how many there are between two times. */
  total(t0, t1) {
    const [first, end] = this.rows(t0, t1, true);
    return this.columns.length ? this.columns[1].subarray(first, end).reduce((sum, count) => sum + count, 0) : 0;
  }

  /** Of events: what fired near a time. */
  near(t, distance) {
    const [first, end] = this.rows(t - distance, t + distance, true);
    if (first === end) return "";
    const [block, what] = this.header.events[this.columns[0][first]];
    const others = this.total(t - distance, t + distance) - 1;
    return `${block}: ${what} at ${+this.t[first].toPrecision(8)} s${others ? ` and ${others} more` : ""}`;
  }
}

/** Draw a column. u: the plot; scale: that of the values. */
export function lineDrawn({ ctx, bbox, scales }, scale, curve, column, { color, dash, width, alpha, dots }) {
  const { min: t0, max: t1 } = scales.x;
  const [first, end] = curve.rows(t0, t1);
  const [kx, ky, ratio] = [bbox.width / (t1 - t0), bbox.height / (scale.max - scale.min), devicePixelRatio];
  const [t, values, base] = [curve.t, curve.columns[column], bbox.top + bbox.height];
  const path = new Path2D();
  let [isDown, drawn, wasX, wasY] = [false, 0, 0, 0];
  for (let i = first; i < end; i += 1) {
    const value = values[i];
    if (value - value !== 0) {
      isDown = false; // a gap
      continue;
    }
    const [x, y] = [bbox.left + (t[i] - t0) * kx, base - (value - scale.min) * ky];
    // What moves by less than half a pixel is not seen, and would take its time.
    if (isDown && i + 1 < end && Math.abs(x - wasX) < 0.75 && Math.abs(y - wasY) < 0.5) continue;
    if (isDown) path.lineTo(x, y);
    else path.moveTo(x, y);
    [isDown, wasX, wasY] = [true, x, y];
    drawn += 1;
    if (dots && end - first < bbox.width / 8) path.rect(x - ratio, y - ratio, 2 * ratio, 2 * ratio), path.moveTo(x, y);
  }
  Object.assign(ctx, { strokeStyle: color, lineWidth: width * ratio, globalAlpha: alpha, lineJoin: "round" });
  // Where a line fills its area, a dash would not be seen and takes the time of ten lines.
  ctx.setLineDash(drawn > 2 * bbox.width ? [] : dash.map((length) => length * ratio));
  ctx.stroke(path);
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

/** The least and the largest value of a band between two times; without one Infinity and -Infinity. */
export function bandRange(band, name, element, t0, t1) {
  const levels = band?.signals[name]?.map((one) => one[element]) ?? [];
  const seen = levels.flatMap((level) => level.filter((value, i) => value !== null && band.t[i] >= t0 && band.t[i] <= t1));
  return [Math.min(...seen), Math.max(...seen)];
}

/** Draw the outer quantiles of a sweep as an area, and the middle one as a thin line. */
export function bandDrawn(u, scale, { t, signals }, name, element, color) {
  const quantiles = signals[name]?.map((one) => one[element]);
  if (!quantiles) return;
  const { ctx, bbox } = u;
  const y = (value) => bbox.top + bbox.height * (1 - (value - scale.min) / (scale.max - scale.min));
  const trace = (path, values, order) => order.forEach((i) => values[i] !== null && path.lineTo(u.valToPos(t[i], "x", true), y(values[i])));
  const [forward, area, middle] = [[...t.keys()], new Path2D(), new Path2D()];
  trace(area, quantiles[0], forward);
  trace(area, quantiles.at(-1), forward.toReversed());
  trace(middle, quantiles[quantiles.length >> 1], forward);
  Object.assign(ctx, { fillStyle: color, strokeStyle: color, lineWidth: devicePixelRatio, globalAlpha: 0.2 });
  ctx.fill(area);
  ctx.globalAlpha = 0.6;
  ctx.stroke(middle);
  ctx.globalAlpha = 1;
}

/** Draw events: marks that hang from the upper edge. */
export function marksDrawn({ ctx, bbox, scales }, curve, color) {
  const { min: t0, max: t1 } = scales.x;
  const [first, end] = curve.rows(t0, t1, true);
  ctx.fillStyle = color;
  for (let i = first; i < end; i += 1) {
    const x = bbox.left + ((curve.t[i] - t0) / (t1 - t0)) * bbox.width;
    ctx.fillRect(x - devicePixelRatio / 2, bbox.top, devicePixelRatio, 8 * devicePixelRatio);
  }
}
