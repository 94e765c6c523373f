// Experiment of concepts.md: simulates the linear arm of ringing_arm.js exactly, sample by sample, and draws it.
const ringing = (() => {
  const arm = ringingArm, d = arm.tip.length, MOTOR = 1;  // index of the motor angle; the joint angle has index 0
  const sum = (A, B, scale = 1) => A.map((row, i) => row.map((value, j) => value + scale * B[i][j]));
  const product = (A, B) => A.map(row => B[0].map((_, j) => row.reduce((total, value, k) => total + value * B[k][j], 0)));
  const column = values => values.map(value => [value]);

  function dot(a, b) {
    let total = 0;
    for (let i = 0; i < a.length; i++) total += a[i] * b[i];
    return total;
  }

  /** Solves A X = B by elimination with row exchange. */
  function solve(A, B) {
    const n = A.length, rows = A.map((row, i) => [...row, ...B[i]]);
    for (let k = 0; k < n; k++) {
      let best = k;
      for (let i = k + 1; i < n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
      [rows[k], rows[best]] = [rows[best], rows[k]];
      for (let i = 0; i < n; i++) {
        const factor = rows[i][k] / rows[k][k];
        if (i !== k) rows[i] = rows[i].map((value, j) => value - factor * rows[k][j]);
      }
    }
    return rows.map((row, i) => row.slice(n).map(value => value / row[i]));
  }

  /** Returns the exponential of a matrix: Taylor series of A / 2^halvings, squared as many times. */
  function exponential(A) {
    const norm = Math.max(...A.map(row => row.reduce((total, value) => total + Math.abs(value), 0)));
    const halvings = Math.max(0, Math.ceil(Math.log2(norm)) + 2), scale = 2 ** -halvings;
    const small = A.map(row => row.map(value => value * scale)), unit = A.map((row, i) => row.map((_, j) => +(i === j)));
    let result = unit, term = unit;
    for (let k = 1; k <= 10; k++) {
      term = product(term, small).map(row => row.map(value => value / k));
      result = sum(result, term);
    }
    for (let k = 0; k < halvings; k++) result = product(result, result);
    return result;
  }

  /** Returns A and B of x[k + 1] = A x[k] + B u[k] with held torques u, and the jump of x by an impulse on the tip. */
  function sampled(mass, stiffness) {
    const h = arm.period, unit = Array.from({ length: d }, (_, i) => +(i === MOTOR));  // rates times h: a smaller norm
    const part = (row, factor) => row.map(value => -factor * value);
    const restoring = stiffness.map((row, i) => [...part(row, h * h), ...part(arm.damping[i], h)]);
    const accelerations = solve(mass, restoring.map((row, i) => [...row, unit[i] * h * h]));
    const speeds = mass.map((_, i) => Array.from({ length: 2 * d + 1 }, (_, j) => +(j === d + i)));
    const whole = exponential([...speeds, ...accelerations, new Array(2 * d + 1).fill(0)]).slice(0, 2 * d);
    const scale = Array.from({ length: 2 * d + 1 }, (_, i) => (d <= i && i < 2 * d ? h : 1));
    const exact = whole.map((row, i) => row.map((value, j) => value * scale[j] / scale[i]));
    const jump = solve(mass, column(arm.tip)).map(([value]) => value * arm.impulse);
    const [A, B] = [exact.map(row => row.slice(0, 2 * d)), exact.map(row => row[2 * d])];
    return { A, B, jump: [...new Array(d).fill(0), ...jump] };
  }

  /** Returns the lowest natural frequency with held motor, Hz, by inverse iteration. */
  function frequency(mass, stiffness) {
    const free = matrix => matrix.filter((_, i) => i !== MOTOR).map(row => row.filter((_, j) => j !== MOTOR));
    const step = solve(free(stiffness), free(mass));
    let x = column(new Array(d - 1).fill(1)), square = 0;
    for (let k = 0; k < 40; k++) {
      const next = product(step, x), size = Math.hypot(...next.flat());
      square = 1 / size;
      x = next.map(([value]) => [value / size]);
    }
    return Math.sqrt(square) / (2 * Math.PI);
  }

  /** Returns angle and rate of the command: half of the motion accelerates, half brakes; shapers add delayed fractions. */
  function command(time, motion, shaper) {
    const result = [0, 0];
    shaper.times.forEach((delay, i) => {
      const s = Math.min(Math.max((time - delay) / motion, 0), 1), size = shaper.amplitudes[i] * arm.angle;
      result[0] += size * (s < 0.5 ? 2 * s * s : 1 - 2 * (1 - s) ** 2);
      result[1] += size * 4 * Math.min(s, 1 - s) / motion;
    });
    return result;
  }

  /** Simulates settings {payload (kg), stiffness (factor), motion (s), control, tap}; returns states, tip (m) and measures. */
  function simulate({ payload, stiffness, motion, control, tap }) {
    const mass = sum(arm.mass, arm.massByPayload, payload);
    const springs = sum(arm.stiffness, arm.stiffnessByFactor, stiffness);
    const model = sampled(mass, springs), gains = control === "lqr" ? arm.lqr : arm.servo;
    const shaper = arm.shapers[control] ?? { times: [0], amplitudes: [1] }, end = motion + shaper.times.at(-1);
    const [count, tapped] = [arm.duration, tap ? arm.impulseTime : NaN].map(time => Math.round(time / arm.period));
    const states = [new Array(2 * d).fill(0)], commands = [command(0, motion, shaper)];
    let torque = 0;
    for (let k = 0; k < count; k++) {
      const x = states[k], next = command((k + 1) * arm.period, motion, shaper), [angle, rate] = commands[k];
      const deviation = x.map((value, i) => (i % d > MOTOR ? 0 : i < d ? angle : rate) - value);
      const u = arm.inertia * (next[1] - rate) / arm.period + dot(gains, deviation);
      torque = Math.max(torque, Math.abs(u));
      states.push(model.A.map((row, i) => dot(row, x) + model.B[i] * u + model.jump[i] * (k + 1 === tapped)));
      commands.push(next);
    }
    const tip = states.map(x => dot(arm.tip, x.slice(0, d))), after = tip.slice(Math.ceil(end / arm.period));
    const last = tip.findLastIndex(value => Math.abs(value - arm.angle * arm.length) > arm.band);
    return { states, tip, commands, end, torque, frequency: frequency(mass, springs), settled: (last + 1) * arm.period,
             vibration: Math.max(...after) - Math.min(...after) };
  }

  const SLIDERS = [  // name, label, unit, lowest and highest value, step, start
    ["payload", "Payload", "kg", 0, 0.2, 0.01, arm.payload],
    ["stiffness", "Stiffness of the gear", "× nominal", 0.2, 3, 0.1, 1],
    ["motion", "Motion time", "s", 0.4, 3, 0.01, 0.71],
    ["gain", "Drawn deflection", "× true", 1, 10, 1, 2],
    ["time", "Time of the drawing", "s", 0, arm.duration, 0.02, 1.06],
  ];
  const CONTROLS = { none: "none", zv: "input shaper ZV", zvd: "input shaper ZVD", lqr: "feedback (LQR)" };
  const LINES = { command: "command of the motor", bare: "tip without shaper and feedback", joint: "joint", tip: "tip" };

  /** Builds controls and pictures in an element, and draws them after each change. */
  function start(root) {
    const slider = ([name, label, unit, low, high, step, value]) => `<label>${label}: <b>${value}</b> ${unit}
      <input type="range" name="${name}" min="${low}" max="${high}" step="${step}" value="${value}" data-unit="${unit}"></label>`;
    const radio = ([name, label]) => `<label><input type="radio" name="control" value="${name}"${name === "none" ? " checked" : ""}>
      ${label}</label>`;
    const line = ([name, label]) => `<span class="ringing-${name}">${label}</span>`;
    root.innerHTML = `<div class="ringing-columns"><canvas role="img"></canvas><canvas role="img"></canvas></div>
      <p>${Object.entries(LINES).map(line).join(" ")}</p>
      <form class="ringing-columns"><div><fieldset><legend>Control</legend>${Object.entries(CONTROLS).map(radio).join("")}
      </fieldset><label><input type="checkbox" name="tap"> tap the tip at ${arm.impulseTime} s</label>
      ${SLIDERS.slice(0, 3).map(slider).join("")}</div><div><button type="button">Play</button> <button type="reset">Reset</button>
      ${SLIDERS.slice(3).map(slider).join("")}<p role="status"></p></div></form>`;
    const [form, button, status] = ["form", "button", "[role=status]"].map(each => root.querySelector(each));
    const pictures = [...root.querySelectorAll("canvas")], fields = form.elements;
    let run, bare, playing = false, began = 0;

    function settings() {
      const numbers = Object.fromEntries(SLIDERS.map(([name]) => [name, Number(fields[name].value)]));
      return { ...numbers, control: fields.control.value, tap: fields.tap.checked };
    }
    function redraw() {
      for (const each of form.querySelectorAll("[type=range]")) {
        each.previousElementSibling.textContent = each.value;
        each.setAttribute("aria-valuetext", `${each.value} ${each.dataset.unit}`);
      }
      const style = getComputedStyle(root), color = name => style.getPropertyValue(`--${name}`);
      drawArm(pictures[0], run, settings(), color);
      drawLines(pictures[1], run, bare, Number(fields.time.value), color);
    }
    function compute() {
      const given = settings();
      run = simulate(given);
      bare = given.control === "none" ? null : simulate({ ...given, control: "none" });
      status.textContent = describe(run);
      pictures[0].ariaLabel = "Arm from above at the chosen time, with a magnified deflection.";
      pictures[1].ariaLabel = `Angles of command, joint and tip over ${arm.duration} s. ${describe(run)}`;
      redraw();
    }
    function tick(now) {
      if (!playing) return;
      fields.time.value = (now - began) / 1000;
      play(now - began < 1000 * arm.duration);
      redraw();
      requestAnimationFrame(tick);
    }
    function play(on) {
      playing = on;
      button.textContent = on ? "Pause" : "Play";
    }
    button.addEventListener("click", () => {
      if (Number(fields.time.value) >= arm.duration) fields.time.value = 0;
      play(!playing);
      began = performance.now() - 1000 * fields.time.value;
      requestAnimationFrame(tick);
    });
    form.addEventListener("input", event => (["time", "gain"].includes(event.target.name) ? redraw() : compute()));
    form.addEventListener("reset", () => setTimeout(() => { play(false); compute(); }));
    form.addEventListener("submit", event => event.preventDefault());
    new ResizeObserver(() => run && redraw()).observe(root);
    new MutationObserver(redraw).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
    compute();
  }

  function describe({ vibration, settled, frequency, end, torque }) {
    const path = vibration > 2 * arm.length ? "more than the length of the arm" : `${(1000 * vibration).toFixed(1)} mm`;
    const band = `${(1000 * arm.band).toFixed(1)} mm`, still = settled <= arm.duration - 1;
    const rest = still ? `stays within ${band} of the target from ${settled.toFixed(2)} s on` : "does not settle";
    return `This arm rings at ${frequency.toFixed(2)} Hz; shapers and feedback are designed for ${arm.frequency.toFixed(2)} Hz.
      The command ends at ${end.toFixed(2)} s. After that the tip moves by ${path} from peak to peak; it ${rest}.
      Largest motor torque: ${torque.toFixed(2)} N m${torque > arm.limit ? `, above the limit of this motor, ${arm.limit} N m` : ""}.`;
  }

  /** Returns a cleared drawing context in CSS pixels, with width and height. */
  function clear(canvas) {
    const { clientWidth: width, clientHeight: height } = canvas, ratio = devicePixelRatio, context = canvas.getContext("2d");
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    context.scale(ratio, ratio);
    Object.assign(context, { lineJoin: "round", lineCap: "round", font: "12px sans-serif" });
    return { context, width, height };
  }
  function stroke(context, points, color, width, dash = []) {
    context.beginPath();
    points.forEach(([x, y]) => context.lineTo(x, y));
    context.setLineDash(dash);
    Object.assign(context, { strokeStyle: color, lineWidth: width });
    context.stroke();
  }
  function disc(context, [x, y], radius, color) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = color;
    context.fill();
  }

  function drawArm(canvas, run, { payload, gain, time }, color) {
    const { context, width, height } = clear(canvas), x = run.states[Math.round(time / arm.period)];
    const scale = Math.min(width / 1.1, height / 1.15) / arm.length;
    const place = (along, across, angle) => [0.06 * width + scale * (along * Math.cos(angle) - across * Math.sin(angle)),
                                             0.68 * height - scale * (along * Math.sin(angle) + across * Math.cos(angle))];
    const motor = x[MOTOR], size = arm.shapes.length - 1, target = place(arm.length, 0, arm.angle);
    const points = arm.shapes.map((row, i) => {
      const along = arm.length * i / size;
      return place(along, gain * (along * (x[0] - motor) + dot(row, x)), motor);
    });
    stroke(context, [place(0, 0, 0), target], color("command"), 1, [2, 4]);
    stroke(context, [place(0, 0, 0), place(arm.length, 0, motor)], color("command"), 2, [6, 5]);
    stroke(context, points, color("tip"), 4);
    disc(context, points[0], 11, color("joint"));
    disc(context, points.at(-1), 4 + 60 * Math.cbrt(payload / 80), color("tip"));
    context.fillStyle = color("text");
    context.fillText("target", target[0] + 16, target[1] - 6);
    context.fillText("motor", points[0][0] - 12, points[0][1] + 26);
  }

  function drawLines(canvas, run, bare, time, color) {
    const { context, width, height } = clear(canvas), degrees = 180 / Math.PI, left = 34, bottom = height - 22;
    const tips = tip => tip.map(value => degrees * value / arm.length), own = tips(run.tip), other = bare ? tips(bare.tip) : [];
    const range = [...own, ...other], low = Math.max(-60, Math.min(-10, ...range)), high = Math.min(120, Math.max(45, ...range));
    const across = seconds => left + (width - left - 12) * seconds / arm.duration;
    const up = angle => bottom - (bottom - 8) * (Math.min(Math.max(angle, low), high) - low) / (high - low);
    const line = (angles, name, thick, dash) =>
      stroke(context, angles.map((angle, k) => [across(k * arm.period), up(angle)]), color(name), thick, dash);
    context.fillStyle = color("text");
    for (let angle = 15 * Math.ceil(low / 15); angle <= high; angle += 15) {
      stroke(context, [[left, up(angle)], [width - 8, up(angle)]], color("grid"), 1);
      context.fillText(`${angle}°`, 4, up(angle) + 4);
    }
    for (let second = 0; second <= arm.duration; second++) context.fillText(`${second} s`, across(second) - 8, height - 6);
    stroke(context, [[across(time), 8], [across(time), bottom]], color("text"), 1);
    stroke(context, [[across(run.end), 8], [across(run.end), bottom]], color("command"), 1, [2, 4]);
    context.fillText("command ends", across(run.end) + 5, bottom - 6);
    line(other, "bare", 1.5);
    line(run.states.map(x => degrees * x[0]), "joint", 1.5);
    line(run.commands.map(([angle]) => degrees * angle), "command", 1.5, [6, 5]);
    line(own, "tip", 2.2);
  }

  return { simulate, start };
})();
ringing.start(document.getElementById("ringing"));
