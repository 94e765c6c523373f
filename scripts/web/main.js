// Replay page of recorded episodes, or of a running episode received by server-sent events.
import { given } from './given.js';
import { curves, memory, tip } from './kinematics.js';
import { Controls } from './live.js';
import { Plot } from './plots.js';
import { Run, floats, readArm } from './runs.js';
import { View } from './scene.js';
import { onScheme } from './scheme.js';

const write = (element, text) => { if (element.textContent !== text) element.textContent = text; };  // an equal text would be laid out again
const $ = id => document.getElementById(id), { data, stage, source } = given;
const arms = data.arms.map(readArm), runs = data.runs.map(run => new Run(run, arms[run.arm]));
const show = { ghost: true, strain: true, trace: true };
let time = 0, gains = [data.stage.gain, 1], playing = false, speed = 1, dirty = true, following = data.live, frames = 0;
const controls = data.controls ? new Controls($('controls'), $('note'), data.controls) : null;
const last = () => Math.max(...runs.map(run => run.last));
const lines = runs.length > 3 ? 2 : 1, columns = Math.ceil(runs.length / lines);
document.title = $('title').textContent = data.title;

const views = stage ? runs.map(run => new View(run, data.stage, stage.coarse)) : [];
if (stage) {
  stage.open(data.stage);
  controls?.listen(stage, views, [columns, lines]);
  stage.orbit.addEventListener('change', () => { dirty = true; });
}

const labels = runs.map(run => {
  const label = document.createElement('div'), name = document.createElement('b'), said = document.createElement('span');
  label.className = 'label';
  label.style.borderColor = run.colour;
  name.textContent = run.name;  // text given by the user, never HTML
  label.append(name, said);
  $('labels').append(label);
  return { label, said };
});

const seek = t => { time = Math.min(last(), Math.max(0, t)); playing = following = false; pose(); };
const millimetres = e => Number.isFinite(e) ? `tip error ${e < 1e-6 ? 'below 0.001' : (1e3 * e).toPrecision(e < 1e-3 ? 2 : 4)} mm` : '';

function pose() {
  runs.forEach((run, k) => {
    if (run.rows && views[k]) views[k].pose(Math.min(time, run.last), gains, show, data.stage.strain, stage.camera);
    const over = run.violations.find(([from, to]) => from <= time + 1e-9 && time - 1e-9 <= to);
    write(labels[k].said, [run.rows ? millimetres(run.at('error', 0, time)) : 'waiting', time > run.last ? run.note : '', over ? `beyond a limit by up to ${(100 * over[2]).toPrecision(2)} %` : ''].filter(Boolean).join(', '));
  });
  write($('clock'), `${time.toFixed(2)} s`);
  $('time').value = time;
  if (!following) plots.forEach(plot => plot.mark(time));
  dirty = true;
}

// Violations of limits: red parts below the time line.
runs.forEach(run => run.violations.forEach(([from, to]) => {
  const mark = document.createElement('i');
  Object.assign(mark.style, { left: `${100 * from / last()}%`, width: `${100 * (to - from) / last()}%` });
  $('marks').append(mark);
}));

// Plots

const STRIP = 10;  // s; length of the strip charts of a live page
const first = () => data.live ? Math.max(0, runs[0].rows - Math.ceil(STRIP / runs[0].dt)) : 0;
const times = () => Float64Array.from({ length: Math.max(...runs.map(run => run.rows)) - first() }, (_, i) => (first() + i) * runs[0].dt);
const roots = runs[0].arm.links.map((_, j) => `root strain of link ${j + 1} (µε; y solid, z dashed)`);
const names = data.live ? roots : [...new Set(runs.flatMap(run => run.readings.map(each => each.name)))];
const parts = [
  () => runs.map(run => ({ name: run.name, colour: run.colour, number: 0, values: run.series('error', 0, 1e3, first()) })),
  () => runs.flatMap(run => run.arm.links.map((_, j) => ({ name: `${run.name} ${j + 1}`, colour: run.colour, number: j, values: run.series('torque', j, 1, first()) }))),
  () => runs.flatMap(run => {
    const chosen = $('reading').value, link = roots.indexOf(chosen);
    if (data.live) return [0, 1].map(c => ({ name: `${run.name} ${'yz'[c]}`, colour: run.colour, number: c, values: run.series('strain', 3 * link + c, 1e6, first()) }));
    const size = run.readings.find(each => each.name === chosen)?.size ?? 0;
    return Array.from({ length: size }, (_, c) => ({ name: `${run.name} ${c + 1}`, colour: run.colour, number: c, values: run.reading(chosen, c) }));
  }),
];
names.forEach(name => $('reading').append(new Option(name, name)));
$('plot3').hidden = !names.length;
const plots = [new Plot($('plot1'), 'tip error (mm)', seek, true), new Plot($('plot2'), 'torque / limit (joints: solid, dashed, dotted)', seek, false)];
if (names.length) plots.push(new Plot($('plot3'), '', seek, false));
const redraw = () => plots.forEach((plot, k) => plot.show(times(), parts[k]()));
$('reading').onchange = () => { plots[2].show(times(), parts[2]()); plots[2].mark(time); };

// Controls

const magnified = ['link deflection', 'joint twist'], sliders = ['gain', 'twist'];
const said = () => {
  const texts = magnified.map((name, k) => `${name} \u00d7 ${+gains[k].toPrecision(2)}`).filter((_, k) => gains[k] !== 1);
  $('gaintext').textContent = texts.length ? `${texts.join(', ')}; violet dot: true tip` : 'true scale';
  $('ghosttext').hidden = !show.ghost;
  $('bar').hidden = !show.strain || !data.stage.ends;
  ['low', 'high'].forEach((id, k) => { $(id).textContent = '\u2212+'[k] + data.stage.ends; });
};
sliders.forEach((name, k) => {
  $(name).value = Math.log10(gains[k]);
  $(name).oninput = event => {
    gains[k] = 10 ** +event.target.value;
    if (Math.abs(gains[k] - 1) < 0.03) gains[k] = 1;
    said();
    pose();
  };
});
$('time').oninput = event => seek(+event.target.value);
$('play').onclick = () => {
  if (controls) { controls.post({ pause: following && !controls.state.paused }); following = true; return; }
  if (data.live) { following = !following; return; }
  playing = !playing;
  if (playing && time >= last()) time = 0;
};
$('speed').onchange = event => { if (controls) controls.post({ speed: +event.target.value }); else speed = +event.target.value; };
$('step').onclick = () => { following = true; controls.post({ step: 1 }); };
for (const name in show) $(name).onchange = event => { show[name] = event.target.checked; said(); pose(); };
const room = controls ? 0.8 : 1;  // a pushed arm leaves its path
$('home').onclick = () => { stage?.reset(room); };
addEventListener('keydown', event => {
  if (['SELECT', 'INPUT', 'TEXTAREA', 'BUTTON'].includes(event.target.tagName)) return;
  if (event.key === ' ') { event.preventDefault(); $('play').click(); }
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (step) { event.preventDefault(); seek(time + step * runs[0].dt); }
});

function layout() {
  stage?.size(columns, lines);
  labels.forEach(({ label }, k) => {
    label.style.left = `calc(${100 * (k % columns) / columns}% + 12px)`;
    label.style.top = `calc(${100 * Math.floor(k / columns) / lines}% + 10px)`;
  });
  $('time').max = last();
  $('time').step = runs[0].dt / 4;
  requestAnimationFrame(() => plots.forEach(plot => plot.resize()));
  dirty = true;
}

// Live: rows of all runs, event "begin" before a new episode, event "state" for the controls

if (data.live) {
  const width = runs[0].width;
  source.addEventListener('begin', event => {
    if (JSON.parse(event.data).layout !== data.layout) { location.reload(); return; }
    runs.forEach(run => { run.rows = 0; run.tips = []; });
    time = 0;
    dirty = true;
  });
  source.addEventListener('state', event => {
    controls.update(JSON.parse(event.data));
    $('speed').value = speed = controls.state.speed;
  });
  source.onmessage = event => {
    dirty = true;
    const rows = floats(event.data);
    for (let i = 0; i < rows.length / width; i++) runs[i % runs.length].add(rows.subarray(i * width, (i + 1) * width));
    $('time').max = last();
  };
  let charted = 0;  // number of rows in the charts
  setInterval(() => {
    if (!following || runs[0].rows < 2 || runs[0].rows === charted) return;
    charted = runs[0].rows;
    plots.forEach((plot, k) => { plot.set(times(), parts[k]()); plot.mark(last()); });
  }, 200);
  $('speed').hidden = !controls;
  $('step').hidden = !controls;
  if (controls) $('speed').lastElementChild.remove();  // faster than real time
}

redraw();
said();
layout();
stage?.reset(room);
pose();
addEventListener('resize', layout);
onScheme(() => {
  views.forEach(view => view.paint());
  plots.forEach(plot => plot.mark(plot.time));
  dirty = true;
});
let before = performance.now();
requestAnimationFrame(function loop(now) {
  if (playing) {
    time += speed * (now - before) / 1e3;
    if (time >= last()) { time = last(); playing = false; }
    pose();
  }
  if (following) {  // the time of the newest row, reached smoothly
    const newest = last(), then = Math.min(newest, Math.max(newest - 0.3 * speed, time + speed * (now - before) / 1e3));
    if (then !== time || dirty) { time = then; pose(); controls?.draw?.(); }
  }
  before = now;
  write($('play'), (controls ? following && !controls.state.paused : data.live ? following : playing) ? '\u275a\u275a' : '\u25b6');
  if (dirty && stage) { dirty = false; frames += 1; stage.draw(views, columns, lines); }
  requestAnimationFrame(loop);
});

// For tests and the console: tips in metres at the displayed time, colours of the surfaces.
window.replay = {
  seek, runs, plots, controls, stage, views, frames: () => frames, shown: () => !dirty && time === last(), rows: () => runs.map(run => run.rows),
  tips: (g = 1, j = 1) => runs.map(run => Array.from(tip(curves(run.arm, run.coordinates(time, new Float64Array(run.arm.width)), [g, j], memory(run.arm))))),
  drawn: () => views.map(view => view.tip.position.toArray()),
  colours: () => views.map(view => Array.from(view.body.geometry.attributes.color.array)),
};
