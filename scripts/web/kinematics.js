// Kinematics: positions of all link sections from the coordinates of a state, as in fm.curves.

const product = (a, b) => {
  const out = new Float64Array(9);
  for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++)
    out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return out;
};

const rotation = (x, y, z) => {
  const a = Math.hypot(x, y, z), s = a > 1e-8 ? Math.sin(a) / a : 1, c = a > 1e-8 ? (1 - Math.cos(a)) / (a * a) : 0.5;
  return [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y, c * x * y + s * z, 1 - c * (x * x + z * z),
    c * y * z - s * x, c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)];
};

// Buffers of the curves of an arm: positions and curvatures (n P 3), frames (n P 9), stretch (n P), joint axes (n 3).
export const memory = arm => {
  const places = arm.links.length * arm.points;
  return { position: new Float64Array(3 * places), frame: new Float64Array(9 * places),
    curvature: new Float64Array(3 * places), stretch: new Float64Array(places),
    axis: new Float64Array(3 * arm.links.length) };
};

// Fill the buffers for coordinates q, with the deflection of the links and the twist of the joints magnified by gains.
export function curves(arm, q, [gain, twist], out) {
  const P = arm.points, moved = new Float64Array(10);
  let turned = [1, 0, 0, 0, 1, 0, 0, 0, 1], origin = [0, 0, 0];
  arm.links.forEach((link, i) => {
    const motor = q[link.motor], angle = motor + twist * (q[i] - motor), axis = link.axis;
    turned = product(turned, link.mount);
    for (let a = 0; a < 3; a++)
      out.axis[3 * i + a] = turned[3 * a] * axis[0] + turned[3 * a + 1] * axis[1] + turned[3 * a + 2] * axis[2];
    turned = product(turned, rotation(axis[0] * angle, axis[1] * angle, axis[2] * angle));
    const [first, last] = link.elastic, k = last - first, { rows, slopes, before } = link;
    let drawn = 0, point = 0, frame = turned, place = 0;
    for (let p = 0; p < P; p++) {
      for (let c = 0; c < 10; c++) {
        moved[c] = 0;
        for (let j = 0; j < k; j++) moved[c] += rows[(p * 10 + c) * k + j] * q[first + j];
      }
      for (; point < before[p]; point++) for (let c = 0; c < 2; c++) {
        let slope = 0;
        for (let j = 0; j < k; j++) slope += slopes[(2 * point + c) * k + j] * q[first + j];
        drawn += slope * slope;
      }
      const x = link.length * p / (P - 1) + gain * moved[0] - gain * gain * drawn;
      const y = gain * moved[1], z = gain * moved[2];
      place = i * P + p;
      for (let a = 0; a < 3; a++) {
        out.position[3 * place + a] = origin[a] + turned[3 * a] * x + turned[3 * a + 1] * y + turned[3 * a + 2] * z;
        out.curvature[3 * place + a] = moved[7 + a];
      }
      out.stretch[place] = moved[6];
      frame = product(turned, rotation(gain * moved[3], gain * moved[4], gain * moved[5]));
      out.frame.set(frame, 9 * place);
    }
    origin = [out.position[3 * place], out.position[3 * place + 1], out.position[3 * place + 2]];
    turned = frame;
  });
  return out;
}

// Tip position from filled buffers.
export const tip = out => out.position.slice(-3);
