// One picture of the service's, drawn in the frame's window: the frame itself, or what the model makes of it.
import { pixelRatio } from "./gl.js";
import { Newest } from "./newest.js";
import { toned } from "./tone.js";

export class Picture {
  // `wants(estimate)`: the name of the file to fetch, or null for none; `done(estimate, note)` after each fetch
  constructor(canvas, api, wants, done, restMs = 0) {
    Object.assign(this, { canvas, api, wants, done });
    this.newest = new Newest((estimate) => this.fetch(estimate), restMs);
    this.tone = { gain: 1, colours: "grey" };
    this.reset(null);
  }

  reset(session) {
    this.session = session;
    this.newest.forget();
    this.estimate = null;
    this.keep(null);
  }

  keep(bitmap) {
    this.bitmap?.close();
    this.bitmap = bitmap;
    this.shown = bitmap && toned(bitmap, this.tone.gain, this.tone.colours);
  }

  setTone(tone) {
    this.tone = tone;
    this.shown = this.bitmap && toned(this.bitmap, tone.gain, tone.colours);
  }

  async show(estimate) {
    await this.newest.take(estimate);
  }

  async fetch(estimate) {
    const name = this.wants(estimate);
    if (!name) return;
    let bitmap = null, note = "";
    try {
      const here = `/v1/sessions/${estimate.session_id}/estimates/${estimate.index}`;
      bitmap = await createImageBitmap(await this.api.blob(`${here}/${name}`));
    } catch (error) {
      note = error.status === 410 ? "The image of this frame is no longer kept." : error.message;
    }
    if (estimate.session_id !== this.session?.session_id) { // another session was chosen meanwhile
      bitmap?.close();
      return;
    }
    this.estimate = estimate;
    this.keep(bitmap);
    this.done(estimate, note);
  }

  // `view`: the part of the image that the canvas shows, px
  draw(width, height, view) {
    const { canvas, shown } = this, ratio = pixelRatio();
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    if (!shown || !view) return;
    const scale = canvas.width / (view.right - view.left), context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    context.drawImage(shown, -view.left * scale, -view.top * scale, shown.width * scale, shown.height * scale);
  }
}
