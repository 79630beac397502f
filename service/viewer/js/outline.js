// Silhouettes of poses as outlines, at the screen's resolution: each pose is drawn as a mask, then its edge.
import {
  Color, DoubleSide, Mesh, MeshBasicMaterial, NoBlending, OrthographicCamera, PlaneGeometry, Scene, ShaderMaterial,
  Vector2, WebGLRenderTarget,
} from "../vendor/three/three.module.min.js";
import { fitRenderer, openRenderer, SOFTWARE } from "./gl.js";
import { onScreen } from "./rotation.js";

const EDGE = {
  vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
  fragmentShader: `
    varying vec2 at;
    uniform sampler2D mask;
    uniform vec2 pixel;
    uniform float radius, strength, tint;
    uniform vec3 colour;
    void main() {
      float inside = texture2D(mask, at).r, around = inside;
      for (int i = 0; i < 12; i++) {
        float turn = float(i) * 0.5235988;
        around += texture2D(mask, at + radius * pixel * vec2(cos(turn), sin(turn))).r;
      }
      float edge = smoothstep(0.0, 0.55, 1.0 - abs(2.0 * around / 13.0 - 1.0));
      float alpha = max(edge * strength, inside * tint);
      gl_FragColor = vec4(colour * alpha, alpha);
    }`,
};

export class Outlines {
  constructor(canvas) {
    this.renderer = openRenderer(canvas, { premultipliedAlpha: true });
    if (!this.renderer) return;
    this.renderer.autoClear = false;
    this.target = new WebGLRenderTarget(1, 1, { samples: SOFTWARE ? 0 : 4 });
    this.camera = new OrthographicCamera();
    this.scene = new Scene();
    this.body = null;
    this.edge = new ShaderMaterial({
      ...EDGE,
      transparent: true,
      premultipliedAlpha: true,
      depthTest: false,
      uniforms: {
        mask: { value: this.target.texture },
        pixel: { value: new Vector2() },
        radius: { value: 1 },
        strength: { value: 1 },
        tint: { value: 0 },
        colour: { value: new Color() },
      },
    });
    this.sheet = new Scene().add(new Mesh(new PlaneGeometry(2, 2), this.edge));
    this.sheet.children[0].frustumCulled = false;
    this.white = new MeshBasicMaterial({ color: 0xffffff, side: DoubleSide, blending: NoBlending, toneMapped: false });
  }

  setBody(body) {
    if (!this.renderer || body === this.body) return;
    this.body = body;
    this.scene.clear();
    this.group = body?.instance(() => this.white);
    if (this.group) this.scene.add(this.group);
  }

  // `window`: the part of the image that is seen, px. `lines`: [{pose, colour, width, strength, tint}], last on top.
  // `lens`: {focal, x, y} of a pinhole camera, px, or null.
  draw(width, height, window, lines, lens = null) {
    if (!this.renderer) return;
    fitRenderer(this.renderer, width, height);
    this.renderer.setRenderTarget(null);
    this.renderer.clear();
    if (!this.group) return;
    const size = this.renderer.getDrawingBufferSize(new Vector2());
    this.target.setSize(size.x, size.y);
    this.edge.uniforms.pixel.value.set(1 / size.x, 1 / size.y);
    for (const line of lines) this.drawOne(line, size.x / width, window, lens);
  }

  drawOne({ pose, colour, width, strength, tint }, ratio, window, lens) {
    const reach = pose.scale_px * this.body.radius * 4 + 1; // joints may carry parts out of the sphere at rest
    if (lens) this.lookThrough(lens, window, reach);
    else this.lookFromAfar(window, reach);
    this.body.setJoints(this.group, pose.joints);
    this.group.quaternion.copy(onScreen(pose.orientation));
    this.group.position.set(pose.x_px - (lens?.x ?? 0), (lens?.y ?? 0) - pose.y_px, lens ? -lens.focal : 0);
    this.group.scale.setScalar(pose.scale_px);
    this.renderer.setRenderTarget(this.target);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.renderer.setRenderTarget(null);
    const { uniforms } = this.edge;
    uniforms.radius.value = width * ratio;
    uniforms.strength.value = strength;
    uniforms.tint.value = tint;
    uniforms.colour.value.setStyle(colour, ""); // as it stands: what is drawn goes to the screen without conversion
    this.renderer.render(this.sheet, this.camera);
  }

  lookFromAfar({ left, top, right, bottom }, reach) {
    Object.assign(this.camera, { left, right, top: -top, bottom: -bottom, near: -reach, far: reach });
    this.camera.updateProjectionMatrix();
  }

  // A pixel is one long where the body's centre is, the focal length away.
  lookThrough({ focal, x, y }, { left, top, right, bottom }, reach) {
    const near = Math.max(focal - reach, 0.05 * focal), share = near / focal;
    const sides = [share * (left - x), share * (right - x), share * (y - top), share * (y - bottom)];
    this.camera.projectionMatrix.makePerspective(...sides, near, focal + reach);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
  }
}
