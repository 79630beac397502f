// The time line: a slider over all frames with a ribbon of their status, play, step, and back to live.
import { drawRibbon } from "./ribbon.js";

export class Timeline {
  // actions: goTo(index), live(); `rowOf(index)` tells the time of a frame
  constructor(element, actions) {
    this.element = element;
    this.actions = actions;
    this.slider = element.querySelector("input");
    this.ribbon = element.querySelector("canvas");
    this.playButton = element.querySelector(".play");
    this.liveButton = element.querySelector(".live");
    this.label = element.querySelector("output");
    this.index = this.count = 0;
    this.live = true;
    this.slider.addEventListener("input", () => { this.stop(); actions.goTo(Number(this.slider.value)); });
    this.liveButton.addEventListener("click", () => this.goLive());
    this.playButton.addEventListener("click", () => this.toggle());
    element.querySelector(".back").addEventListener("click", () => this.step(-1));
    element.querySelector(".forward").addEventListener("click", () => this.step(1));
    new ResizeObserver(() => this.drawRibbon()).observe(this.ribbon);
  }

  show({ index, count, live, rows, estimate }) {
    const grown = count !== this.count;
    Object.assign(this, { index, count, live, rows });
    this.element.hidden = count === 0;
    this.slider.max = Math.max(count - 1, 0);
    this.slider.value = index;
    this.slider.setAttribute("aria-valuetext", `frame ${index} of ${count}, ${estimate?.status ?? ""}`);
    this.liveButton.setAttribute("aria-pressed", String(live));
    this.label.textContent = `${index} / ${Math.max(count - 1, 0)}`;
    if (grown) this.drawRibbon();
  }

  drawRibbon() {
    if (this.rows) drawRibbon(this.ribbon, this.rows, 0, this.count);
  }

  goLive() {
    this.stop();
    this.actions.live();
  }

  step(by) {
    this.stop();
    this.goTo(this.index + by);
  }

  goTo(index) {
    this.actions.goTo(Math.min(Math.max(index, 0), this.count - 1));
  }

  toggle() {
    if (this.timer) this.stop();
    else this.play();
  }

  // At the speed of the pass; from its beginning where it stands at the end.
  play() {
    if (this.count < 2) return;
    if (this.index >= this.count - 1) this.goTo(0);
    this.playButton.setAttribute("aria-pressed", "true");
    const next = () => {
      if (this.index >= this.count - 1) { this.stop(); return; }
      this.timer = setTimeout(() => { this.goTo(this.index + 1); next(); }, this.gapMs());
    };
    next();
  }

  gapMs() {
    const first = this.rows?.[0]?.index ?? 0;
    const [now, then] = [this.rows?.[this.index - first], this.rows?.[this.index + 1 - first]];
    const gap = now && then ? (then.time - now.time) * 1000 : 100;
    return Math.min(Math.max(gap, 16), 1000);
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = null;
    this.playButton.setAttribute("aria-pressed", "false");
  }
}
