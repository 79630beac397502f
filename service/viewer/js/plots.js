// The time plots: one strip per quantity, all over the same time, with one cursor.
import { modeColour, STATUS } from "./colours.js";
import { angleBetween } from "./rotation.js";
import { Strip } from "./strip.js";

const POSE = [
  { key: "yaw", name: "Yaw", unit: "°", angle: true },
  { key: "pitch", name: "Pitch", unit: "°", angle: true },
  { key: "roll", name: "Roll", unit: "°", angle: true },
  { key: "x", name: "Position x", unit: "px" },
  { key: "y", name: "Position y", unit: "px" },
  { key: "scale", name: "Scale", unit: "px/unit" },
].map((spec) => ({ ...spec, pose: true, least: 0.05, value: (row) => row.best[spec.key] }));

const HEALTH = [
  { name: "Weights of the modes", unit: "%", range: [0, 100], value: (row) => 100 * (row.modes[0]?.weight ?? 0),
    shares: (row) => row.modes.map((mode, rank) => [mode.weight, modeColour(rank)]) },
  { name: "Orientation spread of the heaviest mode", unit: "°", fromZero: true, value: (row) => row.accuracy },
  { name: "Effective sample size", unit: "particles", fromZero: true, colour: "#c792ea", value: (row) => row.ess },
  { name: "Latency", unit: "ms", fromZero: true, colour: "#5ad4a6", value: (row) => row.latency },
];

// What only a filter says that weighs hypotheses.
const EXISTENCE = [
  { name: "It fits, it does not, nothing is there", unit: "%", range: [0, 100],
    value: (row) => row.probabilities && 100 * row.probabilities.fits,
    shares: (row) => (row.probabilities ? ["fits", "no_fit", "absent"].map((name) => [row.probabilities[name], HYPOTHESES[name]]) : []) },
  { name: "Light that the best mode explains", unit: "%", range: [0, 100], colour: "#5ad4a6",
    value: (row) => row.fit && 100 * row.fit.explained },
  { name: "Left over on the body (χ²)", unit: "", fromZero: true, colour: "#ffb454", value: (row) => row.fit?.chi2 },
];
const HYPOTHESES = { fits: STATUS.tracking.colour, no_fit: STATUS.no_fit.colour, absent: STATUS.no_target.colour };
const ZOOM = 2, LEAST_SPAN_S = 1e-3;

const joint = ({ name, kind }) => ({
  key: `joint:${name}`, name, unit: kind === "revolute" ? "°" : "units", pose: true, least: 0.05,
  angle: kind === "revolute", value: (row) => row.best[`joint:${name}`],
});

const against = (spec, reference) => (
  reference ? { ...spec, other: (row) => reference.rowOf(row.index)?.best[spec.key] } : spec);

const angleTo = (reference) => ({ name: `Angle to ${reference.name}`, unit: "°", fromZero: true, pose: true, colour: "#ffffff",
  value: (row) => {
    const other = reference.rowOf(row.index);
    return other && angleBetween(row.orientation, other.orientation);
  } });

export class Plots {
  // `goTo(time)` on a click; `says(text)` what the pointer is over; `zoomed(whether)` a part of the pass is shown
  constructor(element, { goTo, says, zoomed }) {
    Object.assign(this, { element, goTo, says, zoomed });
    this.strips = [];
    this.seconds = null; // of the window; null: the whole pass
    this.part = null; // [from, to] that was chosen, s
    new ResizeObserver(() => this.request()).observe(element);
  }

  // Strips for a session whose estimates have these joints: [{name, kind}]; `weighs`: they tell probabilities;
  // `reference`: what it is compared with, or null (comparison.js).
  build(joints, weighs, reference) {
    const poses = [...POSE, ...joints.map(joint)].map((spec) => against(spec, reference));
    const specs = [...(reference ? [angleTo(reference)] : []), ...poses, ...HEALTH, ...(weighs ? EXISTENCE : [])];
    const names = specs.map((spec) => spec.name).join() + (reference?.id ?? "");
    if (names === this.names) return;
    this.names = names;
    const handlers = { goTo: (time) => this.goTo(time), zoom: (from, to) => this.choose([from, to]),
      whole: () => this.choose(null), hover: (time, x) => this.hover(time, x) };
    for (const strip of this.strips) strip.plot.destroy();
    this.strips = specs.map((spec) => new Strip(spec, handlers));
    this.element.replaceChildren(...this.strips.map((strip) => strip.figure));
  }

  // `cursor`: the row that is looked at, or null for none; `live`: it is the newest.
  show(rows, cursor, live) {
    if (!rows.length && this.part) this.choose(null);
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
    this.element.hidden = !rows?.length;
    if (!rows?.length) return;
    const [from, to] = this.span(rows, cursor);
    const seen = rows.filter((row, i) => (rows[i + 1] ?? row).time >= from && (rows[i - 1] ?? row).time <= to);
    const scene = { rows: seen, from, to, origin: rows[0].time, cursor: live ? null : cursor?.time ?? null };
    for (const strip of this.strips) {
      strip.draw(scene);
      if (!this.hovered) strip.say(cursor);
    }
  }

  // The values under the pointer, in all strips at once.
  hover(time, x) {
    this.hovered = time !== null;
    const { rows, cursor } = this.shown;
    const row = this.hovered ? rows[nearestRow(rows, time)] : cursor;
    for (const strip of this.strips) {
      strip.point(x);
      strip.say(row);
    }
    const said = `frame ${row?.index}, ${(row?.time - rows[0]?.time).toFixed(2)} s, ${STATUS[row?.status]?.says ?? ""}`;
    this.says(this.hovered && row ? said : "");
  }

  // Show a part of the pass: [from, to] in s, or null for all of it.
  choose(part) {
    this.part = part;
    this.zoomed(part !== null);
    this.request();
  }

  // Nearer to the moment that is looked at (factor above 1), or farther from it.
  zoom(factor = ZOOM) {
    const { rows, cursor } = this.shown ?? {};
    if (!rows?.length) return;
    const [from, to] = this.span(rows, cursor), [first, last] = [rows[0].time, rows.at(-1).time];
    const middle = Math.min(Math.max(cursor?.time ?? to, from), to), length = (to - from) / factor;
    if (length >= last - first) this.choose(null);
    else this.choose([middle - length / 2, middle + length / 2]);
  }

  span(rows, cursor) {
    if (this.part) return this.part;
    const [first, last] = [rows[0].time, rows.at(-1).time];
    if (this.seconds === null || last - first <= this.seconds) return [first, Math.max(last, first + LEAST_SPAN_S)];
    const end = Math.min(last, Math.max((cursor?.time ?? last) + this.seconds / 2, first + this.seconds));
    return [end - this.seconds, end];
  }
}

// Index of the row whose time is nearest; rows in the order of time.
export function nearestRow(rows, time) {
  let [low, high] = [0, rows.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (rows[middle].time <= time) low = middle;
    else high = middle - 1;
  }
  const after = rows[low + 1];
  return after && after.time - time < time - rows[low].time ? low + 1 : low;
}
