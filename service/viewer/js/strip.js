// One time plot: the best pose as a line, a band of the heaviest mode's spread, dots for the other modes; or shares
// that are stacked. uPlot draws axes and lines, and tells where the pointer is.
import uPlot from "../vendor/uplot/uPlot.esm.js";
import { modeColour } from "./colours.js";
import { thinned } from "./ribbon.js";

const HEIGHT = 124, LEAST_DRAG_PX = 5, LEAST_WEIGHT = 0.02;
const INK = { grid: "#1d2733", text: "#93a2b4", cursor: "#e8eef6", band: "rgba(77, 163, 255, 0.22)", other: "#ffffff" };
const FONT = "11px system-ui, sans-serif";
const GONE = ["lost", "no_fit", "no_target"];

// spec: {name, unit, value(row), key, colour, angle, range, fromZero, least, pose, shares(row)}; `other(row)`: the same
// quantity of what is compared. handlers: goTo(time), zoom(from, to), whole(), hover(time or null, px)
export class Strip {
  constructor(spec, handlers) {
    Object.assign(this, { spec, handlers, scene: { rows: [], from: 0, to: 1, origin: 0, cursor: null } });
    this.figure = document.createElement("figure");
    this.figure.className = "strip";
    const caption = document.createElement("figcaption"), holder = document.createElement("div");
    this.value = document.createElement("output");
    caption.append(spec.name, this.value);
    holder.setAttribute("role", "img");
    holder.setAttribute("aria-label", `${spec.name} over time`);
    this.figure.append(caption, holder);
    this.plot = new uPlot(this.options(), [[], [], [], [], []], holder);
    this.listen(this.plot.over);
  }

  options() {
    const { spec } = this;
    const line = { points: { show: () => this.scene.rows.length === 1, size: 4 }, ...(spec.angle ? { gaps: turnGaps } : {}) };
    const edge = { ...line, stroke: "transparent", points: { show: false } };
    const axis = { stroke: INK.text, font: FONT, ticks: { show: false }, grid: { stroke: INK.grid, width: 1 } };
    return {
      width: 300, height: HEIGHT, padding: [8, 18, 0, 0], legend: { show: false },
      scales: { x: { time: false, auto: false }, y: { range: () => spec.range ?? rangeOf(this.scene.rows, spec) } },
      axes: [
        { ...axis, size: 22, gap: 2, space: 70, values: (plot, at) => at.map((time) => `${label(time)} s`) },
        { ...axis, size: 46, gap: 4, space: 28, values: (plot, at) => at.map(label) },
      ],
      series: [{}, { ...line, stroke: spec.shares ? "transparent" : spec.colour ?? modeColour(0), width: 1.5 }, edge, edge,
        { ...line, stroke: INK.other, width: 1, dash: [4, 3] }],
      bands: [{ series: [2, 3], fill: INK.band }],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
      hooks: { drawSeries: [(plot, k) => k === 1 && this.drawMarks(plot)], draw: [(plot) => this.drawCursor(plot)],
        setSelect: [(plot) => this.selected(plot)] },
    };
  }

  // A click goes to a moment, a drag chooses a part of the pass, a double click shows all of it again.
  listen(over) {
    let pressed = 0;
    over.addEventListener("mousedown", (event) => { pressed = event.clientX; });
    over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressed) < LEAST_DRAG_PX) this.handlers.goTo(this.timeAt(event.offsetX));
    });
    over.addEventListener("dblclick", () => this.handlers.whole());
    over.addEventListener("mousemove", (event) => this.handlers.hover(this.timeAt(event.offsetX), event.offsetX));
    over.addEventListener("mouseleave", () => this.handlers.hover(null, -1));
  }

  timeAt(x) {
    return this.plot.posToVal(x, "x") + this.scene.origin;
  }

  selected(plot) {
    const { left, width } = plot.select;
    if (width < LEAST_DRAG_PX) return;
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.handlers.zoom(this.timeAt(left), this.timeAt(left + width));
  }

  // scene: {rows, from, to, origin, cursor}: times in s, `origin` that of the first frame
  draw(scene) {
    const width = this.figure.clientWidth;
    if (!width) return;
    this.scene = { ...scene, rows: thinned(scene.rows, width) };
    const { plot, spec } = this;
    if (plot.width !== width) plot.setSize({ width, height: HEIGHT });
    plot.batch(() => {
      plot.setData(columns(this.scene, spec), false);
      plot.setScale("x", { min: scene.from - scene.origin, max: scene.to - scene.origin });
    });
  }

  say(row) {
    const [number, other] = row ? [this.spec.value(row), this.spec.other?.(row)] : [];
    const text = (value) => value.toFixed(Math.abs(value) >= 1000 ? 0 : 2);
    this.value.textContent = number === undefined ? "" : `${text(number)} ${this.spec.unit}`;
    if (other !== undefined) this.value.textContent += ` (${text(other)})`;
  }

  point(x) {
    this.plot.setCursor({ left: x, top: x < 0 ? -10 : 0 }, false);
  }

  drawMarks(plot) {
    const { rows, origin } = this.scene, { ctx: context, bbox } = plot;
    const x = (row) => plot.valToPos(row.time - origin, "x", true), y = (value) => plot.valToPos(value, "y", true);
    context.save();
    context.beginPath();
    context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    context.clip();
    if (this.spec.shares) drawStack(context, rows, this.spec, x, y);
    else if (this.spec.key) drawOthers(context, rows, this.spec, x, y);
    context.restore();
  }

  drawCursor(plot) {
    const { cursor, origin } = this.scene;
    if (cursor === null) return;
    const { ctx: context, bbox } = plot, x = Math.round(plot.valToPos(cursor - origin, "x", true)) + 0.5;
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    context.strokeStyle = INK.cursor;
    context.lineWidth = 1;
    context.setLineDash([]); // the last series' are still set
    context.beginPath();
    context.moveTo(x, bbox.top);
    context.lineTo(x, bbox.top + bbox.height);
    context.stroke();
  }
}

// Whether the plot leaves a row's pose out: nothing is held to be there as the model says.
function isGone(row, spec) {
  return Boolean(spec.pose) && GONE.includes(row.status);
}

// [time, best, upper and lower edge of the band, what is compared]; null breaks a line: a track that is lost.
function columns({ rows, origin }, spec) {
  const known = (value) => (Number.isFinite(value) ? value : null);
  const found = [rows.map((row) => row.time - origin), [], [], [], []];
  for (const row of rows) {
    const gone = isGone(row, spec), mode = row.modes[0];
    const [middle, spread] = spec.key && mode && !gone ? [mode.at[spec.key], mode.spread[spec.key]] : [];
    found[1].push(gone ? null : known(spec.value(row)));
    found[2].push(known(middle + spread));
    found[3].push(known(middle - spread));
    found[4].push(known(spec.other?.(row)));
  }
  return found;
}

// The step from 180 to -180 degrees breaks a line too.
function turnGaps(plot, k, first, last, gaps) {
  const [times, values] = [plot.data[0], plot.data[k]], x = (at) => Math.round(plot.valToPos(times[at], "x", true));
  for (let at = first + 1; at <= last; at++) {
    if (values[at] !== null && values[at - 1] !== null && Math.abs(values[at] - values[at - 1]) > 180) {
      gaps.push([x(at - 1), x(at)]);
    }
  }
  return gaps.sort((a, b) => a[0] - b[0]);
}

// Of what is drawn.
export function rangeOf(rows, spec) {
  let [low, high] = [Infinity, -Infinity];
  const take = (value) => {
    if (!Number.isFinite(value)) return;
    low = Math.min(low, value);
    high = Math.max(high, value);
  };
  for (const row of rows) {
    take(spec.other?.(row));
    if (isGone(row, spec)) continue;
    take(spec.value(row));
    for (const [rank, mode] of (spec.key ? row.modes : []).entries()) {
      const spread = rank === 0 ? mode.spread[spec.key] : 0;
      if (mode.weight < LEAST_WEIGHT) continue;
      take(mode.at[spec.key] - spread);
      take(mode.at[spec.key] + spread);
    }
  }
  if (!(high >= low)) return [0, 1];
  const margin = Math.max((high - low) * 0.08, spec.least ?? 1e-6);
  [low, high] = [spec.fromZero ? 0 : low - margin, high + margin];
  return spec.angle ? [Math.max(low, -180), Math.min(high, 180)] : [low, high];
}

function drawOthers(context, rows, spec, x, y) {
  const size = 2 * uPlot.pxRatio;
  for (const row of rows) {
    row.modes.forEach((mode, rank) => {
      if (rank === 0 || mode.weight < LEAST_WEIGHT || isGone(row, spec)) return;
      context.globalAlpha = 0.25 + 0.75 * mode.weight;
      context.fillStyle = modeColour(rank);
      context.fillRect(x(row) - size / 2, y(mode.at[spec.key]) - size / 2, size, size);
    });
  }
}

function drawStack(context, rows, spec, x, y) {
  rows.forEach((row, i) => {
    const left = Math.floor(x(row)); // whole pixels: no seams between neighbours
    const right = i + 1 < rows.length ? Math.floor(x(rows[i + 1])) : left + 2;
    let below = 0;
    for (const [share, colour] of spec.shares(row)) {
      const [top, bottom] = [Math.round(y(100 * (below + share))), Math.round(y(100 * below))];
      context.fillStyle = colour;
      context.fillRect(left, top, Math.max(right - left, 1), bottom - top);
      below += share;
    }
  });
}

function label(value) {
  return String(Number(value.toPrecision(4)));
}
