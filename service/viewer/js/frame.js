// The frame with the best silhouette in blue and the other modes thinner. Image and outlines are of one frame.
import { modeColour } from "./colours.js";
import { Painter, pixelRatio } from "./gl.js";
import { Outlines } from "./outline.js";

const ZOOM_MARGIN = 1.25; // width of the zoomed view, in widths of the body

export class FrameView {
  constructor(figure, api) {
    this.api = api;
    this.picture = figure.querySelector("canvas.picture");
    this.note = figure.querySelector(".note");
    this.caption = figure.querySelector(".frame-number");
    this.outlines = new Outlines(figure.querySelector("canvas.outlines"));
    this.painter = new Painter(figure.querySelector(".stage"), (width, height) => this.draw(width, height));
    this.options = { outlines: true, modes: true, zoom: false };
    this.reset(null);
  }

  reset(session) {
    this.session = session;
    this.size = session?.background ?? null;
    this.wanted = this.shown = this.bitmap = this.body = null;
    this.chosen = -1;
    this.outlines.setBody(null);
    this.caption.textContent = "";
    this.say("");
    this.painter.request();
  }

  toggle(name) {
    this.options[name] = !this.options[name];
    this.painter.request();
    return this.options[name];
  }

  setBody(body) {
    this.body = body;
    this.outlines.setBody(body);
    this.painter.request();
  }

  highlight(rank) {
    this.chosen = rank;
    this.painter.request();
  }

  // Newest wins: one picture is fetched at a time, what comes meanwhile replaces what waits.
  async show(estimate) {
    this.wanted = estimate;
    if (this.fetching) return;
    this.fetching = true;
    while (this.wanted) {
      const next = this.wanted;
      this.wanted = null;
      await this.fetch(next);
    }
    this.fetching = false;
  }

  async fetch(estimate) {
    const here = `/v1/sessions/${estimate.session_id}/estimates/${estimate.index}`;
    const drawn = this.outlines.renderer ? "frame.png" : "overlay.png";
    let bitmap = null, note = "";
    try {
      bitmap = await createImageBitmap(await this.api.blob(`${here}/${drawn}`));
    } catch (error) {
      note = error.status === 410 ? "The image of this frame is no longer kept." : error.message;
    }
    if (estimate.session_id !== this.session?.session_id) return; // another session was chosen meanwhile
    this.bitmap?.close();
    Object.assign(this, { bitmap, shown: estimate });
    if (bitmap) this.size = { width: bitmap.width, height: bitmap.height };
    this.say(note);
    this.caption.textContent = estimate.index;
    this.painter.request();
  }

  say(text) {
    this.note.textContent = text;
    this.note.hidden = !text;
  }

  // The part of the image in view, px, with the shape of the element.
  window(width, height) {
    const zooms = this.options.zoom && this.shown && this.body;
    return windowOn(this.size, width, height, zooms ? this.body.box(this.shown.best) : null);
  }

  draw(width, height) {
    const ratio = pixelRatio();
    this.picture.width = Math.round(width * ratio);
    this.picture.height = Math.round(height * ratio);
    if (!this.size) {
      this.outlines.draw(width, height, { left: 0, right: 1, top: 0, bottom: 1 }, []);
      return;
    }
    const view = this.window(width, height);
    const scale = this.picture.width / (view.right - view.left);
    if (this.bitmap) {
      const context = this.picture.getContext("2d");
      context.imageSmoothingEnabled = false;
      context.drawImage(this.bitmap, -view.left * scale, -view.top * scale,
        this.bitmap.width * scale, this.bitmap.height * scale);
    }
    this.outlines.draw(width, height, view, this.lines());
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
    return [...lines, best];
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
