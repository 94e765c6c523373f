// Plots over time; a click seeks to the time.
import uPlot from 'uplot';
import { pick } from './scheme.js';

const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3]];
const INK = pick('#111827', '#d1d5db'), LABEL = '12px system-ui, sans-serif', GRID = { stroke: pick('#e5e7eb', '#374151'), width: 1 };
const DECADES = (_, values) => values.map(v => Number.isInteger(Math.round(1e6 * Math.log10(v)) / 1e6) ? v : null);
const NUMBERS = (_, values) => values.map(v => v === null ? null : v && Math.abs(v) < 1e-3 ? (+v.toPrecision(4)).toExponential() : (v || 0).toLocaleString('en', { maximumSignificantDigits: 6 }));
const LEAST = 1e-3;  // mm; lower limit of logarithmic axes

export class Plot {
  constructor(element, title, seek, powers) {
    Object.assign(this, { element, title, seek, powers, time: 0, head: element.querySelector('select')?.clientHeight ?? 0 });
  }

  // Show lines (name, colour, number for the dashes, values) over times.
  show(times, lines) {
    this.u?.destroy();
    const mark = u => {
      const x = u.valToPos(this.time, 'x', true), c = u.ctx;
      c.save();
      c.setLineDash([]);  // reset the dashes of the last line
      c.strokeStyle = INK();
      c.lineWidth = devicePixelRatio;
      c.beginPath();
      c.moveTo(x, u.bbox.top);
      c.lineTo(x, u.bbox.top + u.bbox.height);
      c.stroke();
      c.restore();
    };
    const small = lines.length > 4;
    const series = lines.map(l => ({ label: l.name, stroke: l.colour, width: 1.4, dash: DASHES[l.number % DASHES.length], points: { show: false } }));
    const limits = { x: { time: false }, y: this.powers ? { distr: 3 } : {} };
    this.u = new uPlot({ title: this.title, ...this.room(), legend: { show: !small, live: false }, cursor: { drag: { x: false, y: false } },
      scales: limits, axes: [{ stroke: INK, size: 26, label: 'time (s)', labelSize: 18, labelGap: 0, labelFont: LABEL, grid: GRID }, { stroke: INK, size: 64, values: NUMBERS, ...(this.powers ? { grid: { ...GRID, filter: DECADES }, ticks: { filter: DECADES }, filter: DECADES } : { grid: GRID }) }], series: [{ label: 'time' }, ...series], hooks: { draw: [mark] } },
    this.data(times, lines), this.element);
    this.u.over.addEventListener('pointerdown', event => {
      const go = e => this.seek(this.u.posToVal(e.clientX - this.u.over.getBoundingClientRect().left, 'x'));
      const stop = () => { removeEventListener('pointermove', go); removeEventListener('pointerup', stop); };
      go(event);
      addEventListener('pointermove', go);
      addEventListener('pointerup', stop);
    });
    requestAnimationFrame(() => this.resize());  // the legend is laid out one frame later
  }

  data(times, lines) { return [times, ...lines.map(l => this.powers ? l.values.map(v => v === null ? null : Math.max(v, LEAST)) : l.values)]; }

  set(times, lines) { this.u.setData(this.data(times, lines)); }

  // uPlot needs sizes as numbers, without title and legend.
  room() { return { width: Math.max(this.element.clientWidth, 50), height: Math.max(this.element.clientHeight - this.head - 40, 50) }; }

  resize() {
    const legend = this.element.querySelector('.u-legend')?.clientHeight ?? 0, title = this.element.querySelector('.u-title')?.clientHeight ?? 0;
    this.u.setSize({ width: this.room().width, height: Math.max(this.element.clientHeight - this.head - legend - title - 4, 50) });
  }

  mark(time) {
    this.time = time;
    this.u.redraw(false, false);
  }
}
