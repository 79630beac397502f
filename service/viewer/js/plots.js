// The time plots: one strip per quantity, all over the same time, with one cursor. Click or drag to go to a frame.
import { drawStrip, timeAt } from "./strip.js";

const POSE = [
  { key: "yaw", name: "Yaw", unit: "°", angle: true },
  { key: "pitch", name: "Pitch", unit: "°", angle: true },
  { key: "roll", name: "Roll", unit: "°", angle: true },
  { key: "x", name: "Position x", unit: "px" },
  { key: "y", name: "Position y", unit: "px" },
  { key: "scale", name: "Scale", unit: "px/unit" },
].map((spec) => ({ ...spec, pose: true, least: 0.05, value: (row) => row.best[spec.key] }));

const HEALTH = [
  { name: "Weights of the modes", unit: "%", stack: true, range: [0, 100], value: (row) => 100 * (row.modes[0]?.weight ?? 0) },
  { name: "Orientation spread of the heaviest mode", unit: "°", fromZero: true, value: (row) => row.accuracy },
  { name: "Effective sample size", unit: "particles", fromZero: true, colour: "#c792ea", value: (row) => row.ess },
  { name: "Latency", unit: "ms", fromZero: true, colour: "#5ad4a6", value: (row) => row.latency },
];

const joint = ({ name, kind }) => ({
  key: `joint:${name}`, name, unit: kind === "revolute" ? "°" : "units", pose: true, least: 0.05,
  angle: kind === "revolute", value: (row) => row.best[`joint:${name}`],
});

export class Plots {
  constructor(element, goTo) {
    this.element = element;
    this.goTo = goTo;
    this.strips = [];
    this.seconds = null; // of the window; null: the whole pass
    this.scene = null;
    new ResizeObserver(() => this.request()).observe(element);
  }

  // Strips for a session whose estimates have these joints: [{name, kind}].
  build(joints) {
    const specs = [...POSE, ...joints.map(joint), ...HEALTH];
    const names = specs.map((spec) => spec.name).join();
    if (names === this.names) return;
    this.names = names;
    this.strips = specs.map((spec) => this.strip(spec));
    this.element.replaceChildren(...this.strips.map((strip) => strip.figure));
  }

  strip(spec) {
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption"), value = document.createElement("output");
    const canvas = document.createElement("canvas");
    figure.className = "strip";
    caption.append(spec.name, value);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${spec.name} over time`);
    figure.append(caption, canvas);
    const point = (event) => {
      if (!this.scene) return;
      this.goTo(timeAt(canvas, this.scene, event.offsetX));
    };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); point(event); });
    canvas.addEventListener("pointermove", (event) => { if (canvas.hasPointerCapture(event.pointerId)) point(event); });
    return { spec, figure, canvas, value };
  }

  // `cursor`: the row that is looked at, or null for none; `live`: it is the newest.
  show(rows, cursor, live) {
    this.shown = { rows, cursor, live };
    this.request();
  }

  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  draw() {
    const { rows, cursor, live } = this.shown ?? {};
    this.scene = null;
    this.element.hidden = !rows?.length;
    if (!rows?.length) return;
    const [from, to] = this.span(rows, cursor);
    const seen = rows.filter((row) => row.time >= from && row.time <= to);
    this.scene = { rows: seen, from, to, origin: rows[0].time, cursor: live ? null : cursor?.time ?? null };
    for (const { spec, canvas, value } of this.strips) {
      drawStrip(canvas, spec, this.scene);
      const number = cursor ? spec.value(cursor) : undefined;
      value.textContent = number === undefined ? "" : `${number.toFixed(number >= 1000 ? 0 : 2)} ${spec.unit}`;
    }
  }

  span(rows, cursor) {
    const [first, last] = [rows[0].time, rows.at(-1).time];
    if (this.seconds === null || last - first <= this.seconds) return [first, Math.max(last, first + 1e-3)];
    const end = Math.min(last, Math.max((cursor?.time ?? last) + this.seconds / 2, first + this.seconds));
    return [end - this.seconds, end];
  }
}
