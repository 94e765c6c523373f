// Controls of a live page: they send commands to the session and show its state. All names are text, never HTML.
import { ArrowHelper, Vector3 } from 'three';

const tag = (name, properties, ...children) => {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
};
const NEAR = 36;  // pixels; largest distance from the tip or the target at which a press grabs it

export class Controls {
  constructor(root, note, about) {
    Object.assign(this, { root, note, about, state: { paused: false, speed: 1 }, sliders: {}, sent: Promise.resolve(), mode: 'push' });
    const { environments, environment, conditions, condition, agents, chosen } = about;
    const choose = (name, options, value, message) => {
      const select = tag('select', { ariaLabel: name, name }, ...options.map(each => new Option(each, each)));
      select.value = value;
      select.onchange = () => this.post(message(select.value));
      return tag('label', {}, tag('span', { textContent: name }), select);
    };
    const button = (name, title, press) => tag('button', { name, type: 'button', textContent: title, onclick: press });
    const other = chosen[1] ?? 'none';
    this.code = tag('textarea', { readOnly: true, hidden: true, ariaLabel: 'code', rows: 9, spellcheck: false });
    root.append(
      tag('fieldset', {}, tag('legend', { textContent: 'Episode' }),
        choose('environment', environments, environment, value => ({ environment: value })),
        choose('condition', conditions, condition, value => ({ environment: `${environment}/${value}` })),
        choose('agent', agents, chosen[0], value => ({ agents: [value, ...chosen.slice(1)] })),
        choose('beside it', ['none', ...agents], other, value => ({ agents: value === 'none' ? [chosen[0]] : [chosen[0], value] })),
        tag('p', {}, button('again', 'again', () => this.post({ again: 0 })), button('next', 'new target', () => this.post({ again: 1 }))),
        tag('p', { className: 'hint' }, `Pull the ball at the tip to push it${about.movable ? ', drag the red target to move it' : ''}. Where both are, grab the `, this.grab())),
      this.table('values', 'Arm and signals (a new episode)', 'onchange'), this.table('gains', 'Gains of the PD (at once)', 'oninput'),
      tag('fieldset', {}, tag('legend', { textContent: 'Keep' }),
        tag('p', {}, button('save', 'save episode', () => this.post({ save: 0 })), button('code', 'copy as code', () => this.copy())), this.code));
    root.hidden = false;
  }

  grab() {
    const select = tag('select', { ariaLabel: 'grab', name: 'grab' }, new Option('tip', 'push'), new Option('target', 'target'));
    select.onchange = () => { this.mode = select.value; };
    return select;
  }

  table(group, title, when) {
    const rows = this.about[group].map(([name, label, low, high, step]) => {
      const log = !step, [from, to] = log ? [low, high].map(Math.log10) : [low, high];
      const input = tag('input', { type: 'range', name, min: from, max: to, step: log ? 0.01 : step }), output = tag('output', {});
      const value = () => log ? 10 ** +input.value : +input.value;
      const show = () => { input.ariaValueText = output.textContent = String(+value().toPrecision(3)); };
      input.addEventListener('input', show);
      input[when] = () => this.post({ [group]: { [name]: value() } });
      this.sliders[`${group}.${name}`] = position => { if (!input.matches(':active')) { input.value = log ? Math.log10(position) : position; show(); } };
      return tag('label', {}, tag('span', { textContent: label }), input, output);
    });
    return tag('fieldset', { hidden: !rows.length }, tag('legend', { textContent: title }), ...rows);
  }

  // Messages are sent one after the other, so that a push ends after it has begun.
  post(message) {
    this.sent = this.sent.then(async () => {
      const answer = await (await fetch('control', { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(message) })).json();
      if (answer.error) this.note.textContent = answer.error;
      return answer;
    }).catch(() => { this.note.textContent = 'the session does not answer'; return {}; });
    return this.sent;
  }

  async copy() {
    this.code.value = (await this.post({ code: 0 })).code ?? '';
    this.code.hidden = false;
    await navigator.clipboard?.writeText(this.code.value).catch(() => this.code.select());
  }

  update(state) {
    this.state = state;
    for (const group of ['values', 'gains']) for (const name in state[group]) this.sliders[`${group}.${name}`]?.(state[group][name]);
    this.note.textContent = state.message;
  }

  // Let the mouse or a finger push the tips and move the target; other presses turn the view.
  listen(stage, views, shape) {
    const { canvas, camera } = stage, colour = 0xd97706;
    const arrows = views.map(view => { const arrow = new ArrowHelper(new Vector3(1, 0, 0), new Vector3(), 1, colour); arrow.visible = false; view.scene.add(arrow); return arrow; });
    const place = event => {  // number of the view, and position in it, from -1 to 1
      const box = canvas.getBoundingClientRect(), [columns, lines] = shape, w = box.width / columns, h = box.height / lines;
      const u = (event.clientX - box.left) / w, v = (event.clientY - box.top) / h;
      return { view: views[Math.floor(v) * columns + Math.floor(u)], x: 2 * (u % 1) - 1, y: 1 - 2 * (v % 1), w, h };
    };
    const distance = (p, point) => { const at = point.clone().project(camera); return Math.hypot((at.x - p.x) * p.w / 2, (at.y - p.y) * p.h / 2); };
    const across = view => {  // normal of the plane of a planar arm, otherwise the direction of view
      const axes = Array.from({ length: view.out.axis.length / 3 }, (_, j) => new Vector3().fromArray(view.out.axis, 3 * j));
      const sight = camera.getWorldDirection(new Vector3());
      return axes.every(axis => Math.abs(axis.dot(axes[0])) > 0.999) && Math.abs(axes[0].dot(sight)) > 0.2 ? axes[0] : sight;
    };
    const hit = (p, point, normal) => {
      const ray = new Vector3(p.x, p.y, 0.5).unproject(camera).sub(camera.position);
      return camera.position.clone().addScaledVector(ray, normal.dot(point.clone().sub(camera.position)) / normal.dot(ray));
    };
    let held = null;
    this.draw = () => arrows.forEach((arrow, k) => arrow.position.copy(views[k].tip.position));
    const pull = vector => {
      arrows.forEach(arrow => { arrow.visible = vector.length() > 0; if (arrow.visible) { arrow.setDirection(vector.clone().normalize()); arrow.setLength(vector.length()); } });
      this.post({ push: vector.clone().multiplyScalar(this.about.pull).toArray() });
    };
    canvas.addEventListener('pointerdown', event => {
      const p = place(event), view = p.view;
      const near = { push: distance(p, view.tip.position), target: this.about.movable ? distance(p, view.target.position) : Infinity };
      const found = Object.keys(near).filter(name => near[name] < NEAR), name = found.length > 1 ? this.mode : found[0];
      if (!name) return;
      event.stopImmediatePropagation();
      const point = (name === 'push' ? view.tip : view.target).position.clone(), normal = across(view);
      held = { id: event.pointerId, name, point, normal, start: hit(p, point, normal), at: point };
      canvas.setPointerCapture(event.pointerId);
    }, { capture: true });
    canvas.addEventListener('pointermove', event => {
      if (held?.id !== event.pointerId) return;
      const moved = hit(place(event), held.point, held.normal).sub(held.start);
      held.at = held.point.clone().add(moved);
      if (held.name === 'push') pull(moved);
      else views.forEach(view => { view.aim = held.at; });
    });
    for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, async event => {
      if (held?.id !== event.pointerId) return;
      const { name, at } = held;
      held = null;
      if (name === 'push') pull(new Vector3());
      else if (end === 'pointerup') await this.post({ target: at.toArray() });
      views.forEach(view => { view.aim = null; });
    });
  }
}
