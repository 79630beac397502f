// What acts on the frame's picture: outline, modes, zoom and model on or off, contrast, colours, save.
import { download } from "./download.js";
import { tellProblem } from "./notices.js";
import { titleOf } from "./sessions.js";
import { COLOURS } from "./tone.js";

export class FrameTools {
  constructor(figure, frame) {
    Object.assign(this, { figure, frame });
    this.contrast = figure.querySelector("[name=contrast]");
    this.colours = figure.querySelector("[name=colours]");
    for (const button of figure.querySelectorAll("[data-toggle]")) {
      button.addEventListener("click", () => this.toggle(button.dataset.toggle));
    }
    this.contrast.addEventListener("input", () => this.tone());
    this.colours.addEventListener("change", () => this.tone());
    figure.querySelector(".save").addEventListener("click", () => this.save());
  }

  toggle(name) {
    const on = this.frame.toggle(name);
    this.figure.querySelector(`[data-toggle="${name}"]`).setAttribute("aria-pressed", String(on));
  }

  tone() {
    const gain = 2 ** Number(this.contrast.value);
    this.contrast.setAttribute("aria-valuetext", `${gain} times`);
    this.frame.setTone({ gain, colours: this.colours.value });
  }

  brighter(by) {
    this.contrast.value = Number(this.contrast.value) + by; // the slider holds its bounds
    this.tone();
  }

  nextColours() {
    this.colours.value = COLOURS[(COLOURS.indexOf(this.colours.value) + 1) % COLOURS.length];
    this.tone();
  }

  async save() {
    const { session, shown } = this.frame;
    if (!shown) return;
    try {
      download(await this.frame.snapshot().convertToBlob({ type: "image/png" }), `${titleOf(session)}-frame-${shown.index}.png`);
    } catch (error) {
      tellProblem(error);
    }
  }
}
