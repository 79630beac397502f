// The particles on the sphere of orientations: each point is where the telescope stands, seen from the body; its
// tick is the image's up direction there. Point and tick together are the whole orientation, so twins are two clouds.
import {
  BufferAttribute, BufferGeometry, Color, Group, LineBasicMaterial, LineSegments, Line, Points,
  OrthographicCamera, Quaternion, Scene, ShaderMaterial, Vector3,
} from "../vendor/three/three.module.min.js";
import { modeColour } from "./colours.js";
import { fitRenderer, makeTurnable, openRenderer, Painter, pixelRatio } from "./gl.js";
import { axes, drawn, lights } from "./model.js";
import { Newest } from "./newest.js";
import { angleBetween, lineOfSight } from "./rotation.js";

const MOST = 2000; // particles asked for
const TICK = 0.07;
const LATEST_WAIT_MS = 300, REST_MS = 60; // between two fetches, two drawings: nobody reads 30 clouds a second
const FRONT = new Vector3(0, 0, 1);

// What lies on the far side is dimmed: `facing` is 1 in front, -1 behind.
const VERTEX = `
  attribute vec3 colour; attribute float weight; varying vec4 shade; uniform float size;
  void main() {
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    float facing = normalize(mat3(modelViewMatrix) * position).z;
    shade = vec4(colour, mix(0.16, 0.95, smoothstep(-0.15, 0.25, facing)));
    gl_PointSize = size * weight;
    gl_Position = projectionMatrix * seen;
  }`;
const DOT = `varying vec4 shade;
  void main() { float r = length(gl_PointCoord - 0.5); if (r > 0.5) discard;
    gl_FragColor = vec4(shade.rgb, shade.a * smoothstep(0.5, 0.32, r)); }`;
const STROKE = "varying vec4 shade; void main() { gl_FragColor = vec4(shade.rgb, shade.a * 0.5); }";

const material = (fragmentShader) => new ShaderMaterial({ vertexShader: VERTEX, fragmentShader, transparent: true,
  depthWrite: false, depthTest: false, uniforms: { size: { value: 4 } } });

export class CloudView {
  constructor(figure, api) {
    this.api = api;
    this.newest = new Newest((estimate) => this.fetch(estimate), LATEST_WAIT_MS);
    const canvas = figure.querySelector("canvas");
    this.note = figure.querySelector(".note");
    this.renderer = openRenderer(canvas);
    this.camera = new OrthographicCamera();
    this.camera.position.z = 10;
    this.globe = new Group().add(graticule(), axes(1.12));
    this.points = new Points(new BufferGeometry(), material(DOT));
    this.ticks = new LineSegments(new BufferGeometry(), material(STROKE));
    this.trail = new Line(new BufferGeometry(), new LineBasicMaterial({ color: 0x4da3ff, transparent: true, opacity: 0.35 }));
    for (const item of [this.points, this.ticks, this.trail]) item.frustumCulled = false;
    this.globe.add(this.trail, this.ticks, this.points);
    this.scene = new Scene().add(this.globe, ...lights());
    this.painter = new Painter(figure.querySelector(".stage"), (width, height) => this.draw(width, height), REST_MS);
    this.turnable = makeTurnable(canvas, () => this.painter.request());
    canvas.addEventListener("dblclick", () => this.resetView());
    this.reset(null);
  }

  reset(session) {
    this.session = session;
    this.newest.forget();
    this.estimate = this.particles = null;
    this.body?.removeFromParent();
    this.body = null;
    this.plot([], []);
    this.setTrail([]);
    this.aimed = false;
    this.note.textContent = "";
    this.painter.request();
  }

  setBody(body) {
    this.body?.removeFromParent();
    this.body = drawn(body);
    this.body.scale.setScalar(0.42 / body.radius);
    this.globe.add(this.body);
    this.painter.request();
  }

  // Turn the sphere so that the best orientation lies before the viewer.
  resetView() {
    if (!this.estimate) return;
    const { towards } = lineOfSight(this.estimate.best.orientation);
    this.turnable.reset();
    this.turnable.turn.setFromUnitVectors(towards, new Vector3(0.25, 0.2, 1).normalize());
    this.painter.request();
  }

  setTrail(rows) {
    this.path = rows;
    this.painter.request();
  }

  drawTrail() {
    if (!this.path) return;
    this.trail.geometry.dispose();
    this.trail.geometry = new BufferGeometry().setFromPoints(
      this.path.map((row) => lineOfSight(row.orientation).towards.multiplyScalar(1.003)));
    this.path = null;
  }

  async show(estimate) {
    this.estimate = estimate;
    if (!this.aimed) this.resetView();
    this.aimed = true;
    if (!this.particles) this.plotModes(estimate); // else the last cloud stays until the next is there
    await this.newest.take(estimate);
  }

  async fetch(estimate) {
    let particles = null;
    try {
      particles = await this.api.json(
        `/v1/sessions/${estimate.session_id}/particles?index=${estimate.index}&most=${MOST}`);
    } catch (error) {
      if (error.status !== 410) this.note.textContent = error.message;
    }
    if (estimate.session_id !== this.session?.session_id) return;
    this.particles = particles;
    if (particles) this.plotParticles(particles, estimate);
    else if (this.estimate === estimate) this.plotModes(estimate);
  }

  plotParticles({ orientation, weights }, estimate) {
    const most = Math.max(...weights);
    const poses = orientation.map(([w, x, y, z]) => ({ w, x, y, z }));
    const ranks = poses.map((pose) => nearest(pose, estimate.modes));
    this.plot(poses.map((pose, i) => ({ pose, colour: modeColour(ranks[i]), weight: 0.5 + Math.sqrt(weights[i] / most) })),
      estimate.modes);
    this.note.textContent = `frame ${estimate.index}, ${poses.length} of ${estimate.particles} particles`;
  }

  plotModes(estimate) {
    this.plot([], estimate.modes);
    this.note.textContent = `frame ${estimate.index}, modes only`;
  }

  plot(particles, modes) {
    const dots = particles.concat(modes.map((mode, rank) => (
      { pose: mode.pose.orientation, colour: modeColour(rank), weight: 2.2 + 2.5 * Math.sqrt(mode.weight) })));
    fill(this.points.geometry, dots, 1);
    fill(this.ticks.geometry, dots, 2);
    this.painter.request();
  }

  draw(width, height) {
    if (!this.renderer) return;
    fitRenderer(this.renderer, width, height);
    const reach = 1.42 / this.turnable.zoom / Math.min(width, height);
    Object.assign(this.camera, { left: -reach * width, right: reach * width, top: reach * height,
      bottom: -reach * height, near: 0, far: 20 });
    this.camera.updateProjectionMatrix();
    this.drawTrail();
    this.globe.quaternion.copy(this.turnable.turn);
    this.points.material.uniforms.size.value = 0.014 * Math.min(width, height) * pixelRatio();
    this.renderer.render(this.scene, this.camera);
  }
}

function nearest(pose, modes) {
  let [best, least] = [0, Infinity];
  modes.forEach((mode, rank) => {
    const angle = angleBetween(pose, mode.pose.orientation);
    if (angle < least) [best, least] = [rank, angle];
  });
  return best;
}

// One vertex per dot, or two (both ends of its tick).
function fill(geometry, dots, ends) {
  geometry.dispose(); // gives the buffers of the old attributes back
  const position = new Float32Array(dots.length * ends * 3), colour = position.slice();
  const weight = new Float32Array(dots.length * ends).fill(1);
  const shade = new Color();
  dots.forEach((dot, i) => {
    const { towards, up } = lineOfSight(dot.pose);
    shade.set(dot.colour).convertLinearToSRGB();
    for (let end = 0; end < ends; end++) {
      const at = i * ends + end;
      towards.clone().addScaledVector(up, end * TICK * Math.min(2, dot.weight)).toArray(position, 3 * at);
      shade.toArray(colour, 3 * at);
      weight[at] = dot.weight;
    }
  });
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setAttribute("colour", new BufferAttribute(colour, 3));
  geometry.setAttribute("weight", new BufferAttribute(weight, 1));
  geometry.setDrawRange(0, weight.length);
}

function graticule() {
  const at = [];
  const circle = (point) => {
    for (let k = 0; k < 96; k++) at.push(point((k * Math.PI) / 48), point(((k + 1) * Math.PI) / 48));
  };
  for (let latitude = -60; latitude <= 60; latitude += 30) {
    const [r, z] = [Math.cos((latitude * Math.PI) / 180), Math.sin((latitude * Math.PI) / 180)];
    circle((t) => new Vector3(r * Math.cos(t), r * Math.sin(t), z));
  }
  for (let longitude = 0; longitude < 180; longitude += 30) {
    const turned = new Quaternion().setFromAxisAngle(FRONT, (longitude * Math.PI) / 180);
    circle((t) => new Vector3(Math.cos(t), 0, Math.sin(t)).applyQuaternion(turned));
  }
  return new LineSegments(new BufferGeometry().setFromPoints(at),
    new LineBasicMaterial({ color: 0x6d86a6, transparent: true, opacity: 0.3 }));
}
