// Experiment of concepts.md: simulates the linear arm of ringing_arm.js exactly, sample by sample, and draws it.
const ringing = (() => {
  const arm = ringingArm, d = arm.tip.length, MOTOR = 1;  // index of the motor angle; the joint angle has index 0
  const sum = (A, B, scale = 1) => A.map((row, i) => row.map((value, j) => value + scale * B[i][j]));
  const product = (A, B) => A.map(row => B[0].map((_, j) => row.reduce((total, value, k) => total + value * B[k][j], 0)));
  const dot = (a, b) => a.reduce((total, value, i) => total + value * b[i], 0);
  const column = values => values.map(value => [value]);

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
    for (let k = 1; k <= 14; k++) {
      term = product(term, small).map(row => row.map(value => value / k));
      result = sum(result, term);
    }
    for (let k = 0; k < halvings; k++) result = product(result, result);
    return result;
  }

  /** Returns the sampled model x[k + 1] = A x[k] + B u[k] of a constant torque u, and the state jump by an impulse on the tip. */
  function sampled(mass, stiffness) {
    const forces = mass.map((_, i) => [...stiffness[i].map(value => -value), ...arm.damping[i].map(value => -value), +(i === MOTOR)]);
    const speeds = mass.map((_, i) => Array.from({ length: 2 * d + 1 }, (_, j) => +(j === d + i)));
    const block = [...speeds, ...solve(mass, forces), new Array(2 * d + 1).fill(0)];
    const whole = exponential(block.map(row => row.map(value => value * arm.period))).slice(0, 2 * d);
    const jump = solve(mass, column(arm.tip)).map(([value]) => value * arm.impulse);
    return { A: whole.map(row => row.slice(0, 2 * d)), B: whole.map(row => row[2 * d]), jump: [...new Array(d).fill(0), ...jump] };
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
    const mass = sum(arm.mass, arm.massByPayload, payload), springs = sum(arm.stiffness, arm.stiffnessByFactor, stiffness);
    const model = sampled(mass, springs), gains = control === "lqr" ? arm.lqr : arm.servo;
    const shaper = arm.shapers[control] ?? { times: [0], amplitudes: [1] }, end = motion + shaper.times.at(-1);
    const count = Math.round(arm.duration / arm.period), states = [new Array(2 * d).fill(0)], commands = [command(0, motion, shaper)];
    let torque = 0;
    for (let k = 0; k < count; k++) {
      const x = states[k], next = command((k + 1) * arm.period, motion, shaper), [angle, rate] = commands[k];
      const deviation = x.map((value, i) => (i % d > MOTOR ? 0 : i < d ? angle : rate) - value);
      const u = arm.inertia * (next[1] - rate) / arm.period + dot(gains, deviation);
      torque = Math.max(torque, Math.abs(u));
      states.push(model.A.map((row, i) => dot(row, x) + model.B[i] * u));
      if (tap && k + 1 === Math.round(arm.impulseTime / arm.period)) states[k + 1] = states[k + 1].map((value, i) => value + model.jump[i]);
      commands.push(next);
    }
    const tip = states.map(x => dot(arm.tip, x.slice(0, d))), after = tip.slice(Math.ceil(end / arm.period));
    const last = tip.findLastIndex(value => Math.abs(value - arm.angle * arm.length) > arm.band);
    return { states, tip, commands, end, torque, frequency: frequency(mass, springs), settled: (last + 1) * arm.period,
             vibration: Math.max(...after) - Math.min(...after) };
  }
  return { simulate };
})();
