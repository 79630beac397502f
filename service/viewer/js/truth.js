// The truth of a pass, as `skypose simulate` writes it (truth.csv): what estimates are held against.
import { values } from "./history.js";
import { yawPitchRoll } from "./rotation.js";

const NEEDED = ["frame", "qx", "qy", "qz", "qw", "x_px", "y_px", "scale_px"], BESIDE = ["time_s", "visible"];

// `first`: the line of the pass that is the session's frame 0. Throws an Error that says what is missing.
export function readTruth(text, first = 0) {
  const [head, ...lines] = text.split(/\r?\n/).filter((line) => line.trim()).map((line) => line.split(",").map((cell) => cell.trim()));
  const missing = NEEDED.filter((name) => !head?.includes(name));
  if (missing.length) throw new Error(`the truth lacks the columns ${missing.join(", ")}`);
  const joints = head.filter((name) => !NEEDED.includes(name) && !BESIDE.includes(name));
  const rows = new Map();
  for (const line of lines) {
    const cell = Object.fromEntries(head.map((name, k) => [name, Number(line[k])]));
    if (cell.visible === 0) continue; // there is nothing to be right about
    const orientation = { w: cell.qw, x: cell.qx, y: cell.qy, z: cell.qz };
    const pose = { orientation, ...yawPitchRoll(orientation), x_px: cell.x_px, y_px: cell.y_px, scale_px: cell.scale_px,
      joints: Object.fromEntries(joints.map((name) => [name, cell[name]])) };
    rows.set(cell.frame - first, { orientation, pose, best: values(pose) });
  }
  return { id: "truth", name: "truth", rowOf: (index) => rows.get(index), poseOf: (index) => rows.get(index)?.pose };
}
