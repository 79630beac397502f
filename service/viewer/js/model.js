// The model in its attitude, as the telescope sees it; a drag walks around it.
import {
  ArrowHelper, CanvasTexture, DirectionalLight, EdgesGeometry, Group, HemisphereLight, LineBasicMaterial, LineSegments,
  MeshStandardMaterial, DoubleSide, OrthographicCamera, Scene, Sprite, SRGBColorSpace, SpriteMaterial, Vector3,
} from "../vendor/three/three.module.min.js";
import { fitRenderer, makeTurnable, openRenderer, Painter } from "./gl.js";
import { onScreen } from "./rotation.js";

const BODY = new MeshStandardMaterial({ color: 0xaeb9c6, roughness: 0.75, metalness: 0.15, flatShading: true,
  side: DoubleSide });
const MOVING = new MeshStandardMaterial({ color: 0x5f86c9, roughness: 0.5, metalness: 0.2, flatShading: true,
  side: DoubleSide });
const CREASE = new LineBasicMaterial({ color: 0x0b1016, transparent: true, opacity: 0.55 });
const AXES = [["X", 0xff6b6b, [1, 0, 0]], ["Y", 0x6bd66b, [0, 1, 0]], ["Z", 0x6b9bff, [0, 0, 1]]];
const MAX_CREASED_FACES = 40_000;

export function axes(length) {
  const group = new Group();
  for (const [name, colour, direction] of AXES) {
    const along = new Vector3(...direction);
    group.add(new ArrowHelper(along, new Vector3(), length, colour, length * 0.12, length * 0.05));
    const label = new Sprite(new SpriteMaterial({ map: letter(name, colour), depthTest: false }));
    label.position.copy(along.multiplyScalar(length * 1.1));
    label.scale.setScalar(length * 0.22);
    group.add(label);
  }
  return group;
}

function letter(name, colour) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = canvas.getContext("2d");
  context.font = "600 44px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = `#${colour.toString(16)}`;
  context.fillText(name, 32, 34);
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  return texture;
}

// The body in its colours, creases drawn where the mesh is small enough.
export function drawn(body) {
  const group = body.instance((part, moves) => (moves ? MOVING : BODY));
  if (body.model.faces > MAX_CREASED_FACES) return group;
  for (const mesh of group.children) {
    const creases = new LineSegments(new EdgesGeometry(mesh.geometry, 25), CREASE);
    creases.scale.setScalar(1.001); // just above the faces
    mesh.add(creases);
  }
  return group;
}

export function lights() {
  const sun = new DirectionalLight(0xffffff, 2), lamp = new DirectionalLight(0xffffff, 1.3);
  sun.position.set(-0.6, 0.8, 1);
  lamp.position.set(0.2, -0.2, 1); // no side that is seen stays black
  return [sun, lamp, new HemisphereLight(0xbfd4ff, 0x3a4558, 1.1)];
}

// The Sun: its light, and an arrow towards it that stays outside of the body.
class Sun {
  constructor() {
    this.light = new DirectionalLight(0xfff4e0, 3.2);
    this.night = new HemisphereLight(0x8fb0e0, 0x2a3648, 0.7); // as by the Earth: no side is lost altogether
    this.arrow = new ArrowHelper(new Vector3(0, 0, 1), new Vector3(), 0.32, 0xffd479, 0.1, 0.06);
    this.label = new Sprite(new SpriteMaterial({ map: letter("☉", 0xffd479), depthTest: false }));
    this.label.scale.setScalar(0.2);
    this.group = new Group().add(this.light, this.night, this.arrow, this.label);
  }

  point(towards) {
    this.light.position.copy(towards);
    this.arrow.position.copy(towards).multiplyScalar(0.72);
    this.arrow.setDirection(towards);
    this.label.position.copy(towards).multiplyScalar(1.12);
  }
}

export class ModelView {
  constructor(figure) {
    const canvas = figure.querySelector("canvas");
    this.renderer = openRenderer(canvas);
    this.lamps = new Group().add(...lights());
    this.sun = new Sun();
    this.scene = new Scene().add(this.lamps, this.sun.group);
    this.light = figure.querySelector(".light");
    this.holder = new Group();
    this.scene.add(this.holder);
    this.camera = new OrthographicCamera();
    this.camera.position.z = 10;
    this.painter = new Painter(figure.querySelector(".stage"), (width, height) => this.draw(width, height));
    this.turnable = makeTurnable(canvas, () => this.painter.request());
    canvas.addEventListener("dblclick", () => this.resetView());
    this.reset();
  }

  resetView() {
    this.turnable.reset();
    this.painter.request();
  }

  reset() {
    this.holder.clear();
    this.body = this.pose = null;
    this.painter.request();
  }

  setBody(body) {
    this.holder.clear();
    this.body = body;
    this.group = drawn(body);
    this.holder.add(this.group, axes(body.radius * 0.9));
    this.holder.scale.setScalar(1 / body.radius);
    if (this.pose) this.body.setJoints(this.group, this.pose.joints);
    this.painter.request();
  }

  // `sun`: towards the Sun on the screen, or null; `sunlit`: false in the Earth's shadow, null where it is not known
  show(pose, { sun, sunlit } = { sun: null, sunlit: null }) {
    Object.assign(this, { pose, towardsSun: sun });
    this.light.textContent = sunlit === false ? "in the Earth’s shadow" : sun ? "lit by the Sun" : "";
    this.sun.light.visible = sunlit !== false;
    if (this.body) this.body.setJoints(this.group, pose.joints);
    this.painter.request();
  }

  draw(width, height) {
    if (!this.renderer) return;
    fitRenderer(this.renderer, width, height);
    const reach = 1.12 / this.turnable.zoom / Math.min(width, height);
    Object.assign(this.camera, { left: -reach * width, right: reach * width, top: reach * height,
      bottom: -reach * height, near: 0, far: 20 });
    this.camera.updateProjectionMatrix();
    this.holder.visible = Boolean(this.pose);
    if (this.pose) this.holder.quaternion.copy(this.turnable.turn).multiply(onScreen(this.pose.orientation));
    this.sun.group.visible = Boolean(this.pose && this.towardsSun);
    this.lamps.visible = !this.sun.group.visible;
    if (this.towardsSun) this.sun.point(this.towardsSun.clone().applyQuaternion(this.turnable.turn));
    this.renderer.render(this.scene, this.camera);
  }
}
