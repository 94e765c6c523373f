// Runs: episodes as arrays, read from the page or extended by received rows.

import { curves, memory, tip } from './kinematics.js';

const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
const GAP = -(2 ** 15);  // code of a measurement that is not finite
export const floats = text => new Float32Array(bytes(text));

export const readArm = arm => ({ ...arm, links: arm.links.map(link => ({
  ...link, rows: floats(link.rows), slopes: floats(link.slopes), points: floats(link.points),
  normals: floats(link.normals), gauges: floats(link.gauges) })) });

// Columns of a row: coordinates, target, error, torques relative to their limits; of a live page also root strains.
export class Run {
  constructor(data, arm) {
    Object.assign(this, { name: data.name, colour: data.colour, note: data.note, dt: data.dt, arm, scales: data.scales, violations: data.violations ?? [] });
    this.sizes = { x: arm.width, target: 3, error: 1, torque: arm.links.length, ...(data.x ? {} : { strain: 3 * arm.links.length }) };
    this.width = Object.values(this.sizes).reduce((a, b) => a + b);
    this.rows = data.rows;
    this.tips = [];
    for (const name in this.sizes) this[name] = data.rows ? floats(data[name]) : new Float32Array(1024 * this.sizes[name]);
    this.readings = (data.readings ?? []).map(each => ({ ...each, values: new Int16Array(bytes(each.values)) }));
  }

  get last() { return Math.max(0, this.rows - 1) * this.dt; }

  // Add a row, given as the concatenated columns.
  add(row) {
    let at = 0;
    for (const name in this.sizes) {
      const size = this.sizes[name];
      if ((this.rows + 1) * size > this[name].length) {
        const more = new Float32Array(2 * this[name].length);
        more.set(this[name]);
        this[name] = more;
      }
      this[name].set(row.subarray(at, at + size), this.rows * size);
      at += size;
    }
    this.rows += 1;
  }

  // Index of the row before a time, and the interpolation weight of the next row.
  place(time) {
    const f = Math.min(Math.max(time / this.dt, 0), this.rows - 1), i = Math.max(0, Math.min(Math.floor(f), this.rows - 2));
    return [i, f - i];
  }

  // Entry c of a column at a time, linear between rows.
  at(name, c, time) {
    const [i, w] = this.place(time), size = this.sizes[name], values = this[name];
    return w === 0 ? values[i * size + c] : (1 - w) * values[i * size + c] + w * values[(i + 1) * size + c];
  }

  coordinates(time, into) {
    for (let c = 0; c < this.arm.width; c++) into[c] = this.at('x', c, time);
    return into;
  }

  // Position of the true tip in a row, computed once.
  tip(row) {
    return this.tips[row] ??= tip(curves(this.arm, this.x.subarray(row * this.arm.width, (row + 1) * this.arm.width), [1, 1], this.memory ??= memory(this.arm)));
  }

  // Entry c of a column over time, from a row on.
  series(name, c, factor = 1, first = 0) {
    const size = this.sizes[name];
    return Array.from({ length: Math.max(0, this.rows - first) }, (_, i) => { const v = factor * this[name][(first + i) * size + c]; return Number.isFinite(v) ? v : null; });
  }

  // Entry c of a measurement over time.
  reading(name, c) {
    const each = this.readings.find(one => one.name === name);
    if (!each || c >= each.size) return Array(this.rows).fill(null);
    return Array.from({ length: this.rows }, (_, i) => { const v = each.values[i * each.size + c]; return v === GAP ? null : v * each.scale[c] + each.middle[c]; });
  }
}
