// Scene: an arm with its undeformed ghost, target, trace, floor and light in three.js.
import { BufferAttribute, BufferGeometry, CircleGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide,
  DynamicDrawUsage, Fog, GridHelper, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, PCFShadowMap, PerspectiveCamera, Scene, ShadowMaterial, SphereGeometry, TorusGeometry, Vector3,
  WebGLRenderer } from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { curves, memory } from './kinematics.js';
import { pick } from './scheme.js';

const SIDES = 16, TRACE = 150, TRACE_STEP = 0.0125, UP = new Vector3(0, 1, 0);
const COLD = [47, 87, 200], MIDDLE = [205, 208, 212], HOT = [192, 32, 44];
const COLOURS = pick(
  { sky: 0xeef2f7, grid: 0x8d99a8, fine: 0xc9d2dd, metal: 0x334155, dim: 0x64748b, tip: 0x1e293b, trace: 0x6d28d9 },
  { sky: 0x111827, grid: 0x4b5563, fine: 0x273244, metal: 0x94a3b8, dim: 0xcbd5e1, tip: 0xf8fafc, trace: 0xa78bfa });
const linear = v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;

function tube(arm, material) {
  const n = arm.links.length, P = arm.points, index = [], geometry = new BufferGeometry();
  const quad = (a, b, c, d) => index.push(a, b, c, a, c, d);
  for (let i = 0; i < n; i++) {
    const at = (p, s) => (i * P + p) * SIDES + s % SIDES;
    for (let p = 0; p < P - 1; p++) for (let s = 0; s < SIDES; s++) quad(at(p, s), at(p, s + 1), at(p + 1, s + 1), at(p + 1, s));
    for (let s = 1; s < SIDES - 1; s++) index.push(at(0, 0), at(0, s + 1), at(0, s), at(P - 1, 0), at(P - 1, s), at(P - 1, s + 1));
  }
  for (const name of ['position', 'normal', 'color'])
    geometry.setAttribute(name, new BufferAttribute(new Float32Array(n * P * SIDES * 3), 3).setUsage(DynamicDrawUsage));
  geometry.setIndex(index);
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

// Set positions and colours; scale: strain at the ends of the colours, one for all links or one for each, 0 for no colours.
function bend(mesh, arm, out, scale) {
  const { position, normal, color } = mesh.geometry.attributes, X = position.array, N = normal.array, C = color.array;
  arm.links.forEach((link, i) => {
    for (let p = 0; p < arm.points; p++) {
      const b = i * arm.points + p, F = out.frame.subarray(9 * b, 9 * b + 9);
      for (let s = 0; s < SIDES; s++) {
        const o = 2 * (p * SIDES + s), v = 3 * (b * SIDES + s), { points, normals, gauges } = link;
        for (let a = 0; a < 3; a++) {
          X[v + a] = out.position[3 * b + a] + F[3 * a + 1] * points[o] + F[3 * a + 2] * points[o + 1];
          N[v + a] = F[3 * a + 1] * normals[o] + F[3 * a + 2] * normals[o + 1];
        }
        const strain = out.stretch[b] - gauges[o] * out.curvature[3 * b + 2] + gauges[o + 1] * out.curvature[3 * b + 1];
        const part = scale ? Math.max(-1, Math.min(1, strain / (scale[i] ?? scale))) : 0, end = part < 0 ? COLD : HOT;
        for (let a = 0; a < 3; a++) C[v + a] = linear(MIDDLE[a] + (end[a] - MIDDLE[a]) * Math.abs(part));
      }
    }
  });
  position.needsUpdate = normal.needsUpdate = color.needsUpdate = true;
}

function sun(reach) {
  const light = new DirectionalLight(0xffffff, 2.2), box = light.shadow.camera;
  light.position.set(-0.35, -0.55, 1).multiplyScalar(3 * reach);
  light.castShadow = true;
  light.shadow.mapSize.set(2048, 2048);
  light.shadow.bias = -5e-4;
  box.left = box.bottom = -1.3 * reach;
  box.right = box.top = 1.3 * reach;
  box.far = 8 * reach;
  return light;
}

// The scene of one run; coarse: without shadows.
export class View {
  constructor(run, stage, coarse) {
    const arm = run.arm, reach = stage.reach, scene = new Scene(), r = arm.radii.at(-1);
    Object.assign(this, { run, stage, scene, q: new Float64Array(arm.width), out: memory(arm), other: memory(arm), painted: [] });
    const plain = name => { const material = new MeshLambertMaterial(); this.painted.push([material, name]); return material; };
    scene.fog = new Fog(0, 2 * stage.distance, 5 * stage.distance);
    scene.add(new HemisphereLight(0xffffff, 0xb9c3d0, 1.9), this.sun = sun(reach));
    this.body = tube(arm, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
    this.ghost = tube(arm, new MeshBasicMaterial({ transparent: true, opacity: 0.25, depthWrite: false }));
    const post = new Mesh(new CylinderGeometry(0.8 * arm.radii[0], 0.8 * arm.radii[0], -stage.floor, 32), plain('dim'));
    post.rotation.x = Math.PI / 2;
    post.position.z = stage.floor / 2;
    this.joints = arm.radii.map(r => new Mesh(new CylinderGeometry(r, r, 2.3 * r, 32), plain('metal')));
    this.tip = new Mesh(new SphereGeometry(r, 24, 16), plain('tip'));
    this.mark = new Mesh(new SphereGeometry(0.5 * r, 24, 16), new MeshBasicMaterial({ color: 0x6d28d9 }));
    const red = new MeshLambertMaterial({ color: 0xe11d48, emissive: 0x70081f });
    this.target = new Group().add(new Mesh(new SphereGeometry(0.55 * r, 24, 16), red), new Mesh(new TorusGeometry(2 * r, 0.2 * r, 10, 48), red));
    for (const mesh of [this.body, post, this.tip, ...this.joints]) mesh.castShadow = true;
    this.trace = new Line(new BufferGeometry().setAttribute('position', new BufferAttribute(new Float32Array(3 * TRACE), 3)), new LineBasicMaterial());
    this.trace.frustumCulled = false;
    this.painted.push([this.ghost.material, 'dim'], [this.trace.material, 'trace']);
    scene.add(this.body, this.ghost, post, ...this.joints, this.tip, this.mark, this.target, this.trace);
    if (!coarse) {
      const floor = new Mesh(new CircleGeometry(4 * reach, 64), new ShadowMaterial({ opacity: 0.25 }));
      floor.position.z = stage.floor;
      floor.receiveShadow = true;
      scene.add(floor);
    }
    this.paint();
  }

  // Set the colours of the present colour scheme.
  paint() {
    const { scene, stage } = this, colours = COLOURS();
    scene.background = new Color(colours.sky);
    scene.fog.color.set(colours.sky);
    for (const [material, name] of this.painted) material.color.set(colours[name]);
    this.grid?.removeFromParent();
    this.grid?.dispose();
    this.grid = new GridHelper(60 * stage.step, 60, colours.grid, colours.fine);
    this.grid.rotation.x = Math.PI / 2;  // three's floor is x-z
    this.grid.position.z = stage.floor - 1e-3 * stage.reach;
    scene.add(this.grid);
  }

  // Set the pose of all objects at a time; gains of links and joints.
  pose(time, gains, show, scale, camera) {
    const { run, out, other, q } = this, arm = run.arm, P = arm.points;
    const end = each => each.position.slice(-3);
    curves(arm, run.coordinates(time, q), gains, out);
    bend(this.body, arm, out, show.strain ? run.scales ?? scale : 0);
    this.ghost.visible = show.ghost;
    if (show.ghost) bend(this.ghost, arm, curves(arm, q, [0, 0], other), 0);
    this.joints.forEach((mesh, j) => {
      mesh.position.fromArray(out.position, 3 * j * P);
      mesh.quaternion.setFromUnitVectors(UP, new Vector3().fromArray(out.axis, 3 * j));
    });
    this.tip.position.fromArray(end(out));
    this.mark.visible = gains.some(gain => gain !== 1);
    this.mark.position.fromArray(end(curves(arm, q, [1, 1], other)));
    const target = [0, 1, 2].map(c => run.at('target', c, time));
    this.target.visible = target.every(Number.isFinite);
    if (this.target.visible) this.target.position.fromArray(this.aim?.toArray() ?? target);
    this.target.quaternion.copy(camera.quaternion);
    this.trace.visible = show.trace;
    if (show.trace) {  // true path of the tip, through stored states
      const way = this.trace.geometry.attributes.position, step = Math.max(1, Math.round(TRACE_STEP / run.dt)), now = end(other);
      const newest = step * Math.floor(run.place(time)[0] / step);
      for (let j = 0; j < TRACE - 1; j++) way.setXYZ(j, ...run.tip(Math.max(0, newest - (TRACE - 2 - j) * step)));
      way.setXYZ(TRACE - 1, ...now);
      way.needsUpdate = true;
    }
  }
}

// True where WebGL is computed without a graphics card.
function software(gl) {
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return /swiftshader|llvmpipe|software/i.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : '');
}

// Renderer, camera and orbit controls shared by all views; throws without WebGL.
export class Stage {
  constructor(canvas, live) {
    const context = live ? canvas.getContext('webgl2', { alpha: false, antialias: false }) : null;  // as slow as the rest of the start
    this.coarse = Boolean(context) && software(context);  // half of the pixels in each direction, without shadows
    if (context && !this.coarse) {  // a context gets no antialiasing afterwards
      context.getExtension('WEBGL_lose_context')?.loseContext();
      canvas.replaceWith(canvas = canvas.cloneNode());
    }
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.coarse, context: this.coarse ? context : undefined });
    this.renderer.debug.checkShaderErrors = false;  // waits for each shader
    this.renderer.shadowMap.enabled = !this.coarse;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.renderer.setScissorTest(true);
    this.camera = new PerspectiveCamera(30);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.canvas = canvas;
  }

  // Compile the shaders of views by the picture of an arm without size.
  compile() {
    const links = [{}], view = new View({ arm: { links, points: 2, width: 1, radii: [1] } }, { reach: 1, distance: 1, floor: -1, step: 1 }, this.coarse);
    this.size(1, 1);
    this.draw([view], 1, 1);
    view.scene.traverse(each => each.geometry?.dispose());
    view.sun.dispose();
  }

  // Prepare for the views of a page.
  open(stage) {
    this.stage = stage;
    this.camera.near = 0.02 * stage.reach;
    this.camera.far = 60 * stage.reach;
  }

  // Nearest camera position with all points in a fraction of the view, as in draw/camera.py.
  reset(part = 1) {
    const back = new Vector3(...this.stage.towards), right = new Vector3(-back.y, back.x, 0).normalize();
    const axes = [right, back.clone().cross(right), back.clone().negate()], room = [0.88 * part, 0.74 * part];
    const seen = this.stage.points.map(point => axes.map(axis => axis.dot(new Vector3(...point))));
    const slope = Math.tan(Math.PI / 12), half = [slope * this.camera.aspect * room[0], slope * room[1]];
    const depths = seen.map(each => each[2]), mean = depths.reduce((a, b) => a + b) / depths.length;
    const least = half.map((h, a) => Math.max(...seen.map(each => each[a] - h * each[2])));
    const most = half.map((h, a) => Math.min(...seen.map(each => each[a] + h * each[2])));
    const depth = Math.min(...half.map((h, a) => (most[a] - least[a]) / (2 * h)), Math.min(...depths) - 0.05 * this.stage.reach);
    const place = [(least[0] + most[0]) / 2, (least[1] + most[1]) / 2, depth];
    const at = new Vector3();
    axes.forEach((axis, a) => at.addScaledVector(axis, place[a]));
    this.camera.position.copy(at);
    this.orbit.target.copy(at.addScaledVector(axes[2], mean - depth));
    this.orbit.update();
  }

  size(columns, lines) {
    const w = this.canvas.clientWidth, h = this.canvas.clientHeight;
    this.renderer.setPixelRatio(this.coarse ? 0.5 : Math.min(devicePixelRatio, 2));
    this.renderer.setSize(w, h, false);
    this.camera.aspect = (w / columns) / (h / lines);
    this.camera.updateProjectionMatrix();
  }

  draw(views, columns, lines) {
    const w = this.canvas.clientWidth / columns, h = this.canvas.clientHeight / lines;
    views.forEach((view, k) => {
      const area = [(k % columns) * w, (lines - 1 - Math.floor(k / columns)) * h, w - 1, h - 1];
      this.renderer.setViewport(...area);
      this.renderer.setScissor(...area);
      this.renderer.render(view.scene, this.camera);
    });
  }
}
