/** Curves of scopes: rows as they come in frames, and how they are drawn on a canvas. */

/** The first index from which on values are at least x. @param {ArrayLike<number>} t */
function lower(t, count, x) {
  let [low, high] = [0, count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] < x) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Times and columns that grow; what an append says to replace is replaced. */
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
  take({ header, t, columns }, since = -Infinity) {
    const from = header.kind === "append" ? header.from - this.lost : 0;
    if (header.kind !== "append") [this.lost, this.count] = [0, 0];
    this.header = header;
    this.count = Math.max(0, from) + t.length;
    if (this.count > this.t.length || this.columns.length !== columns.length) {
      const size = Math.max(1024, 2 * this.count);
      const larger = (old, Kind) => {
        const made = new Kind(size);
        if (old && from > 0) made.set(old.subarray(0, from));
        return made;
      };
      this.t = larger(this.t, Float64Array);
      this.columns = columns.map((_, k) => larger(this.columns[k], Float32Array));
    }
    this.t.set(t, this.count - t.length);
    columns.forEach((column, k) => this.columns[k].set(column, this.count - t.length));
    const gone = lower(this.t, this.count, since);
    if (gone > 8192 && gone > this.count / 2) {
      for (const array of [this.t, ...this.columns]) array.copyWithin(0, gone, this.count);
      this.count -= gone;
      this.lost += gone;
    }
  }

  /** The rows between two times. within: without those to which lines lead on both sides. */
  rows(t0, t1, within = false) {
    const [first, after] = [lower(this.t, this.count, t0), lower(this.t, this.count, t1)];
    let end = after;
    while (end < this.count && this.t[end] <= t1) end += 1;
    return within ? [first, end] : [Math.max(0, first - 1), Math.min(this.count, end + 1)];
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

  /** Of events: how many there are between two times. */
  total(t0, t1) {
    const [first, end] = this.rows(t0, t1, true);
    let sum = 0;
    for (let i = first; i < end; i += 1) sum += this.columns[1][i];
    return sum;
  }

  /** Of events: what fired near a time. */
  near(t, pixel) {
    const [first, end] = this.rows(t - 4 * pixel, t + 4 * pixel, true);
    if (first === end) return "";
    const [block, what] = this.header.events[this.columns[0][first]];
    const others = this.total(t - 4 * pixel, t + 4 * pixel) - 1;
    return `${block}: ${what} at ${+this.t[first].toPrecision(8)} s${others ? ` and ${others} more` : ""}`;
  }
}

/** The value of a column at a time, on the line between its rows; null outside. */
export function near(curve, column, t) {
  const after = lower(curve.t, curve.count, t);
  const values = curve.columns[column];
  if (after < curve.count && curve.t[after] === t) return values[after];
  if (after === 0 || after === curve.count) return null;
  const share = (t - curve.t[after - 1]) / (curve.t[after] - curve.t[after - 1]);
  return (1 - share) * values[after - 1] + share * values[after];
}

/** What is drawn between two times: u is the plot, scale that of the values. */
export const drawn = {
  line(u, scale, curve, column, { color, dash, width, alpha, dots = false }) {
    const { ctx, bbox } = u;
    const { min: t0, max: t1 } = u.scales.x;
    const [first, end] = curve.rows(t0, t1);
    const [kx, ky] = [bbox.width / (t1 - t0), bbox.height / (scale.max - scale.min)];
    const [{ t }, values, left, base] = [curve, curve.columns[column], bbox.left, bbox.top + bbox.height];
    const ratio = devicePixelRatio;
    Object.assign(ctx, { strokeStyle: color, fillStyle: color, lineWidth: width * ratio, globalAlpha: alpha, lineJoin: "round" });
    // A dash would be lost among as many rows as pixels, and takes the time of ten lines.
    ctx.setLineDash(end - first > bbox.width ? [] : dash.map((length) => length * ratio));
    ctx.beginPath();
    let down = false;
    for (let i = first; i < end; i += 1) {
      const value = values[i];
      if (value - value !== 0) {
        down = false; // a gap
        continue;
      }
      const [x, y] = [left + (t[i] - t0) * kx, base - (value - scale.min) * ky];
      if (down) ctx.lineTo(x, y);
      else ctx.moveTo(x, y);
      down = true;
      if (dots && end - first < bbox.width / 8) ctx.fillRect(x - 2 * ratio, y - 2 * ratio, 4 * ratio, 4 * ratio);
    }
    ctx.stroke();
    ctx.globalAlpha = 1;
  },

  /** The outer quantiles of a sweep as an area, the middle one as a thin line. */
  band(u, scale, { t, signals }, name, element, color) {
    const quantiles = signals[name]?.map((one) => one[element]);
    if (!quantiles) return;
    const { ctx, bbox } = u;
    const y = (value) => bbox.top + bbox.height * (1 - (value - scale.min) / (scale.max - scale.min));
    const trace = (path, values, order) => order.forEach((i) => values[i] !== null && path.lineTo(u.valToPos(t[i], "x", true), y(values[i])));
    const forward = t.map((_, i) => i);
    const [area, middle] = [new Path2D(), new Path2D()];
    trace(area, quantiles[0], forward);
    trace(area, quantiles.at(-1), forward.toReversed());
    trace(middle, quantiles[quantiles.length >> 1], forward);
    Object.assign(ctx, { fillStyle: color, strokeStyle: color, lineWidth: devicePixelRatio, globalAlpha: 0.2 });
    ctx.fill(area);
    ctx.globalAlpha = 0.6;
    ctx.setLineDash([]);
    ctx.stroke(middle);
    ctx.globalAlpha = 1;
  },

  /** Events: marks that hang from the upper edge. */
  marks(u, curve, color) {
    const { ctx, bbox } = u;
    const { min: t0, max: t1 } = u.scales.x;
    const [first, end] = curve.rows(t0, t1, true);
    ctx.fillStyle = color;
    ctx.beginPath();
    for (let i = first; i < end; i += 1) {
      const x = bbox.left + ((curve.t[i] - t0) / (t1 - t0)) * bbox.width;
      ctx.rect(x - devicePixelRatio / 2, bbox.top, devicePixelRatio, 8 * devicePixelRatio);
    }
    ctx.fill();
  },
};
