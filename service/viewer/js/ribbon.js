// The pass as a ribbon of status colours, for the time line.
import { STATUS } from "./colours.js";

const UNKNOWN = "#93a2b4";

export function drawRibbon(canvas, rows, first, count) {
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d");
  const each = width / Math.max(count, 1);
  for (const row of thinned(rows, width)) {
    context.fillStyle = STATUS[row.status]?.colour ?? UNKNOWN;
    context.fillRect((row.index - first) * each, 0, Math.max(each * Math.ceil(rows.length / (2 * width)), each) + 0.5, height);
  }
}

// No more rows than two for each pixel.
export function thinned(rows, width) {
  const stride = Math.ceil(rows.length / (2 * width));
  return stride <= 1 ? rows : rows.filter((row, i) => i % stride === 0 || i === rows.length - 1);
}
