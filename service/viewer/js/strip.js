// One time plot on a canvas: the best pose as a line, a band of the heaviest mode's spread, dots for the other modes.
import { modeColour, STATUS } from "./colours.js";

const PAD = { left: 46, right: 10, top: 8, bottom: 18 };
const INK = { grid: "#1d2733", text: "#93a2b4", cursor: "#e8eef6", band: "rgba(77, 163, 255, 0.22)" };
const FONT = "11px system-ui, sans-serif";

export function drawStrip(canvas, spec, scene) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = Math.min(devicePixelRatio, 2);
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = FONT;
  const rows = thinned(scene.rows, width);
  const box = { x0: PAD.left, x1: width - PAD.right, y0: PAD.top, y1: height - PAD.bottom };
  const range = spec.range ?? rangeOf(rows, spec);
  const frame = {
    context, box, rows,
    x: (time) => box.x0 + ((time - scene.from) / (scene.to - scene.from || 1)) * (box.x1 - box.x0),
    y: (value) => box.y1 - ((value - range[0]) / (range[1] - range[0] || 1)) * (box.y1 - box.y0),
  };
  drawGrid(frame, range, scene);
  context.save();
  context.beginPath();
  context.rect(box.x0, 0, box.x1 - box.x0, height);
  context.clip();
  if (spec.stack) drawStack(frame);
  else drawSeries(frame, spec);
  drawCursor(frame, scene);
  context.restore();
}

// Where a pointer at `x` (px in the canvas) points to, as a time.
export function timeAt(canvas, scene, x) {
  const share = (x - PAD.left) / (canvas.clientWidth - PAD.left - PAD.right);
  return scene.from + share * (scene.to - scene.from);
}

function thinned(rows, width) {
  const stride = Math.ceil(rows.length / (2 * width));
  return stride <= 1 ? rows : rows.filter((row, i) => i % stride === 0 || i === rows.length - 1);
}

function rangeOf(rows, spec) {
  let [low, high] = [Infinity, -Infinity];
  const take = (value) => { low = Math.min(low, value); high = Math.max(high, value); };
  for (const row of rows) {
    const value = spec.value(row);
    if (value === undefined) continue;
    take(value);
    for (const [rank, mode] of (spec.key ? row.modes : []).entries()) {
      const spread = rank === 0 ? mode.spread[spec.key] : 0;
      if (mode.weight < 0.02) continue;
      take(mode.at[spec.key] - spread);
      take(mode.at[spec.key] + spread);
    }
  }
  if (!(high >= low)) return [0, 1];
  const margin = Math.max((high - low) * 0.08, spec.least ?? 0);
  [low, high] = [spec.fromZero ? 0 : low - margin, high + margin];
  return spec.angle ? [Math.max(low, -180), Math.min(high, 180)] : [low, high];
}

function drawGrid({ context, box, x, y }, range, scene) {
  context.strokeStyle = INK.grid;
  context.fillStyle = INK.text;
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const value of ticks(range[0], range[1], 3)) {
    line(context, box.x0, Math.round(y(value)) + 0.5, box.x1, Math.round(y(value)) + 0.5);
    context.fillText(label(value), box.x0 - 6, y(value));
  }
  context.textBaseline = "alphabetic";
  context.textAlign = "center";
  for (const time of ticks(scene.from - scene.origin, scene.to - scene.origin, (box.x1 - box.x0) / 90)) {
    const at = x(time + scene.origin);
    line(context, Math.round(at) + 0.5, box.y0, Math.round(at) + 0.5, box.y1);
    context.fillText(`${label(time)} s`, Math.min(Math.max(at, box.x0 + 10), box.x1 - 12), box.y1 + 13);
  }
}

function drawSeries(frame, spec) {
  if (spec.key) {
    drawBand(frame, spec);
    drawOthers(frame, spec);
  }
  const { context, rows, x, y } = frame;
  context.strokeStyle = spec.colour ?? modeColour(0);
  context.lineWidth = 1.5;
  context.lineJoin = "round";
  context.beginPath();
  for (const part of unbroken(rows, spec)) {
    part.forEach((row, i) => context[i ? "lineTo" : "moveTo"](x(row.time), y(spec.value(row))));
    if (part.length === 1) context.arc(x(part[0].time), y(spec.value(part[0])), 1, 0, 7);
  }
  context.stroke();
}

function drawBand({ context, rows, x, y }, spec) {
  context.fillStyle = INK.band;
  const middle = (row) => row.modes[0]?.at[spec.key];
  for (const part of unbroken(rows, { ...spec, value: middle })) {
    context.beginPath();
    part.forEach((row) => context.lineTo(x(row.time), y(middle(row) + row.modes[0].spread[spec.key])));
    part.toReversed().forEach((row) => context.lineTo(x(row.time), y(middle(row) - row.modes[0].spread[spec.key])));
    context.fill();
  }
}

function drawOthers({ context, rows, x, y }, spec) {
  for (const row of rows) {
    row.modes.forEach((mode, rank) => {
      if (rank === 0 || mode.weight < 0.02) return;
      context.globalAlpha = 0.25 + 0.75 * mode.weight;
      context.fillStyle = modeColour(rank);
      context.fillRect(x(row.time) - 1, y(mode.at[spec.key]) - 1, 2, 2);
    });
  }
  context.globalAlpha = 1;
}

// Parts of the pass that a line may join: a lost track, or the step from 180 to -180 degrees, breaks it.
function unbroken(rows, spec) {
  const parts = [];
  let before;
  for (const row of rows) {
    const value = spec.value(row);
    const gone = value === undefined || (spec.pose && (["lost", "no_fit", "no_target"].includes(row.status)));
    if (gone) { before = undefined; continue; }
    if (before === undefined || (spec.angle && Math.abs(value - before) > 180)) parts.push([]);
    parts.at(-1).push(row);
    before = value;
  }
  return parts;
}

function drawStack({ context, box, rows, x }) {
  const height = box.y1 - box.y0;
  rows.forEach((row, i) => {
    const from = x(row.time);
    const to = i + 1 < rows.length ? x(rows[i + 1].time) : from + 2;
    let y = box.y1;
    row.modes.forEach((mode, rank) => {
      context.fillStyle = modeColour(rank);
      const left = Math.floor(from); // whole pixels: no seams between neighbours
      context.fillRect(left, y - mode.weight * height, Math.max(Math.floor(to) - left, 1), mode.weight * height);
      y -= mode.weight * height;
    });
  });
}

function drawCursor({ context, box, x }, scene) {
  if (scene.cursor === null) return;
  context.strokeStyle = INK.cursor;
  context.lineWidth = 1;
  line(context, Math.round(x(scene.cursor)) + 0.5, 0, Math.round(x(scene.cursor)) + 0.5, box.y1);
}

// The pass as a ribbon of status colours, for the time line.
export function drawRibbon(canvas, rows, first, count) {
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d");
  const each = width / Math.max(count, 1);
  for (const row of thinned(rows, width)) {
    context.fillStyle = STATUS[row.status]?.colour ?? INK.text;
    context.fillRect((row.index - first) * each, 0, Math.max(each * Math.ceil(rows.length / (2 * width)), each) + 0.5, height);
  }
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

export function ticks(low, high, about) {
  const raw = (high - low) / Math.max(about, 1);
  if (!(raw > 0)) return [];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((size) => size >= raw);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

function label(value) {
  return String(Number(value.toPrecision(4)));
}
