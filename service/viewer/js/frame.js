// The frame with the best silhouette in blue and the other modes thinner; beside it, if wanted, the model's image of it
// and what that leaves over. Image and outlines are of one frame.
import { modeColour } from "./colours.js";
import { Painter } from "./gl.js";
import { Outlines } from "./outline.js";
import { Picture } from "./picture.js";
import { COLOURS } from "./tone.js";

const ZOOM_MARGIN = 1.25; // width of the zoomed view, in widths of the body
const BESIDE = ["model", "residual"], BESIDE_REST_MS = 300; // they cost the service more than the frame does

// A pinhole camera: focal length and principal point, px; null: the body is far away.
function lensOf(session, { width, height }) {
  const { perspective, principal_point: point } = session?.camera ?? {};
  return perspective ? { focal: perspective, x: point?.[0] ?? width / 2, y: point?.[1] ?? height / 2 } : null;
}

export class FrameView {
  // `wide(whether)`: room is wanted for the pictures beside the frame
  constructor(figure, api, wide) {
    this.wide = wide;
    this.note = figure.querySelector(".note");
    this.caption = figure.querySelector(".frame-number");
    this.outlines = new Outlines(figure.querySelector("canvas.outlines"));
    const [stage, ...beside] = figure.querySelectorAll(".stage");
    const drawn = this.outlines.renderer ? "frame.png" : "overlay.png";
    this.picture = new Picture(figure.querySelector("canvas.picture"), api, () => drawn,
      (estimate, note) => this.take(estimate, note));
    this.beside = BESIDE.map((name, k) => new Picture(beside[k].querySelector("canvas"), api,
      () => (this.options.model ? `${name}.png` : null), (estimate, note) => this.drawBeside(k, note), BESIDE_REST_MS));
    this.notes = beside.map((one) => one.querySelector(".note"));
    this.options = { outlines: true, modes: true, zoom: false, model: false };
    this.tone = { gain: 1, colours: COLOURS[0] };
    this.painter = new Painter(stage, (width, height) => this.draw(width, height));
    this.painters = beside.map((one, k) => new Painter(one, (width, height) => this.paintBeside(k, width, height)));
    this.reset(null);
  }

  get pictures() { return [this.picture, ...this.beside]; }

  reset(session) {
    this.session = session;
    this.size = session?.background ?? null;
    this.wanted = this.shown = this.body = null;
    this.chosen = -1;
    this.reference = null;
    for (const picture of this.pictures) picture.reset(session);
    this.outlines.setBody(null);
    this.caption.textContent = "";
    this.say(this.note, "");
    this.request();
  }

  request() {
    for (const painter of [this.painter, ...this.painters]) painter.request();
  }

  toggle(name) {
    this.options[name] = !this.options[name];
    if (name === "model") {
      this.wide(this.options.model);
      if (this.wanted) this.showBeside(this.wanted);
    }
    this.request();
    return this.options[name];
  }

  // tone: {gain, colours}: see tone.js. What is left over keeps the colours it has.
  setTone(tone) {
    Object.assign(this.tone, tone);
    for (const picture of [this.picture, this.beside[0]]) picture.setTone(this.tone);
    this.beside[1].setTone({ ...this.tone, colours: COLOURS[0] });
    this.request();
  }

  setBody(body) {
    this.body = body;
    this.outlines.setBody(body);
    this.request();
  }

  // Another pose of each frame to draw, in white: comparison.js.
  compare(reference) {
    this.reference = reference;
    this.painter.request();
  }

  highlight(rank) {
    this.chosen = rank;
    this.painter.request();
  }

  show(estimate) {
    this.wanted = estimate; // `shown` once its picture is there
    this.picture.show(estimate);
    this.showBeside(estimate);
  }

  showBeside(estimate) {
    if (!this.options.model) return;
    this.beside.forEach((picture, k) => {
      if (!picture.bitmap && this.notes[k].hidden) this.say(this.notes[k], "being made…"); // seconds, where the service has just been started
      picture.show(estimate);
    });
  }

  take(estimate, note) {
    this.shown = estimate;
    const { bitmap } = this.picture;
    if (bitmap) this.size = { width: bitmap.width, height: bitmap.height };
    this.say(this.note, note);
    this.caption.textContent = estimate.index;
    this.request();
  }

  say(note, text) {
    note.textContent = text;
    note.hidden = !text;
  }

  // The part of the image in view, px, with the shape of the element.
  window(width, height) {
    const zooms = this.options.zoom && this.shown && this.body;
    return windowOn(this.size, width, height, zooms ? this.body.box(this.shown.best) : null);
  }

  draw(width, height) {
    const view = this.size && this.window(width, height);
    this.picture.draw(width, height, view);
    if (view) this.outlines.draw(width, height, view, this.lines(), lensOf(this.session, this.size));
    else this.outlines.draw(width, height, { left: 0, right: 1, top: 0, bottom: 1 }, []);
  }

  drawBeside(k, note) {
    this.say(this.notes[k], note);
    this.painters[k].request();
  }

  paintBeside(k, width, height) {
    this.beside[k].draw(width, height, this.size && this.window(width, height));
  }

  // What is seen of the frame, outlines included, as a canvas.
  snapshot() {
    const { clientWidth: width, clientHeight: height } = this.picture.canvas;
    this.draw(width, height); // now: what WebGL has drawn is gone after this turn
    const canvas = new OffscreenCanvas(this.picture.canvas.width, this.picture.canvas.height);
    const context = canvas.getContext("2d");
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(this.picture.canvas, 0, 0);
    if (this.outlines.renderer) context.drawImage(this.outlines.renderer.domElement, 0, 0, canvas.width, canvas.height);
    return canvas;
  }

  lines() {
    const { shown, options, chosen } = this;
    if (!shown || !options.outlines || shown.status === "no_target") return [];
    const lines = !options.modes ? [] : shown.modes.map((mode, rank) => ({
      pose: mode.pose,
      colour: modeColour(rank),
      width: rank === chosen ? 1.8 : 0.7,
      strength: rank === chosen ? 1 : 0.45 + 0.5 * mode.weight,
      tint: 0,
    })).slice(1, 8).reverse();
    const best = { pose: shown.best, colour: modeColour(0), width: 1.4, strength: 1, tint: 0.13 };
    const other = this.reference?.poseOf(shown.index);
    return [...lines, ...(other ? [{ pose: other, colour: "#ffffff", width: 0.8, strength: 0.9, tint: 0 }] : []), best];
  }
}

// The part of an image that a view shows, px: all of it, or `box`, where that is less.
export function windowOn(image, width, height, box) {
  const reach = (w, h) => Math.max(w / width, h / height) / 2;
  const [w, h] = box ? [box.max.x - box.min.x, box.max.y - box.min.y].map((side) => ZOOM_MARGIN * Math.max(side, 1))
    : [Infinity, Infinity];
  const half = Math.min(reach(w, h), reach(image.width, image.height));
  const along = (middle, size, room) => (2 * room >= size ? size / 2 : Math.min(Math.max(middle, room), size - room));
  const x = along(box ? (box.min.x + box.max.x) / 2 : 0, image.width, half * width);
  const y = along(box ? (box.min.y + box.max.y) / 2 : 0, image.height, half * height);
  return { left: x - half * width, right: x + half * width, top: y - half * height, bottom: y + half * height };
}
