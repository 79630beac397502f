// What the WebGL views share: a renderer that follows its element's size, drawing on demand, turning by drag and keys.
import { Quaternion, Vector2, Vector3, WebGLRenderer } from "../vendor/three/three.module.min.js";

const X = new Vector3(1, 0, 0), Y = new Vector3(0, 1, 0);

// Whether WebGL is drawn by the processor (a virtual machine, a machine without a graphics driver): then every pixel
// costs, and smooth edges are left out so that the page keeps pace with the estimates.
export const SOFTWARE = (() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "");
})();

export const pixelRatio = () => Math.min(devicePixelRatio, SOFTWARE ? 1 : 2);

// null where the browser has no WebGL: the page goes on without.
export function openRenderer(canvas, options) {
  try {
    const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: !SOFTWARE, ...options });
    renderer.setClearColor(0x000000, 0);
    return renderer;
  } catch (error) {
    console.info("no WebGL:", error.message);
    canvas.closest("figure")?.classList.add("no-webgl");
    return null;
  }
}

// Calls draw(width, height) in the next animation frame after request(), at most once in `restMs`, and whenever the
// element changes its size.
export class Painter {
  constructor(element, draw, restMs = 0) {
    Object.assign(this, { element, draw, restMs });
    this.waiting = false;
    this.drawn = -restMs;
    new ResizeObserver(() => this.request()).observe(element);
  }

  request() {
    if (this.waiting) return;
    this.waiting = true;
    const rest = this.drawn + this.restMs - performance.now();
    if (rest > 0) setTimeout(() => this.paint(), rest);
    else this.paint();
  }

  paint() {
    requestAnimationFrame((now) => {
      this.waiting = false;
      this.drawn = now;
      const { clientWidth, clientHeight } = this.element;
      if (clientWidth && clientHeight) this.draw(clientWidth, clientHeight);
    });
  }
}

export function fitRenderer(renderer, width, height) {
  const ratio = pixelRatio();
  const size = renderer.getDrawingBufferSize(new Vector2());
  if (size.x !== Math.floor(width * ratio) || size.y !== Math.floor(height * ratio)) {
    renderer.setPixelRatio(ratio);
    renderer.setSize(width, height, false);
  }
}

// What the viewer has turned the scene by, and how close it is: by drag, and on a focused view by arrow keys, plus and
// minus, and the wheel (elsewhere the wheel scrolls the page).
export function makeTurnable(canvas, changed) {
  const turn = new Quaternion();
  const view = { turn, zoom: 1, reset() { turn.identity(); view.zoom = 1; } };
  const zoom = (factor) => { view.zoom = Math.min(Math.max(view.zoom * factor, 0.5), 20); changed(); };
  const rotate = (dx, dy) => {
    turn.premultiply(new Quaternion().setFromAxisAngle(Y, dx)).premultiply(new Quaternion().setFromAxisAngle(X, dy));
    changed();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) rotate(event.movementX * 0.01, event.movementY * 0.01);
  });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.002));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.2 : 1 / 1.2);
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation(); // the page's own arrows step through the frames
    rotate(...step);
  });
  return view;
}
