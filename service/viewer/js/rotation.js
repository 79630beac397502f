// Rotations and joints, as docs/architecture.md has them: body -> camera (x right, y down, z away).
import { Matrix4, Quaternion, Vector3 } from "../vendor/three/three.module.min.js";

const X = new Vector3(1, 0, 0);

export function quaternionOf({ w, x, y, z }) {
  return new Quaternion(x, y, z, w);
}

// The camera's frame in three.js' own (y up, looking along -z): half a turn about x.
const FLIP = new Quaternion().setFromAxisAngle(X, Math.PI);

export function onScreen(orientation) {
  return FLIP.clone().multiply(quaternionOf(orientation));
}

// Where the telescope stands and which way is up in its image, seen from the body: two unit vectors in body axes.
export function lineOfSight(orientation) {
  const inverse = quaternionOf(orientation).invert();
  return {
    towards: new Vector3(0, 0, -1).applyQuaternion(inverse),
    up: new Vector3(0, -1, 0).applyQuaternion(inverse),
  };
}

// Where the Sun is on the screen (three.js' axes), or null: a mirrored image has it in front instead of behind.
export function sunOnScreen({ light, camera }, session) {
  if (!light?.sun) return null;
  const mirrored = camera?.mirrored ?? session.camera.mirrored;
  return new Vector3(light.sun.x, -light.sun.y, mirrored ? light.sun.z : -light.sun.z);
}

// Intrinsic Z-Y'-X'' angles, degrees, as the service tells them (service/inference/pose.py). For people only.
export function yawPitchRoll({ w, x, y, z }) {
  const degrees = (angle) => (angle * 180) / Math.PI;
  const [m00, m10, m20] = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)];
  const [m21, m22] = [2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], cosine = Math.hypot(m00, m10);
  const locked = cosine < 1e-9; // straight up or down: all of it is yaw
  const yaw = locked ? Math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)) : Math.atan2(m10, m00);
  return { yaw_deg: degrees(yaw), pitch_deg: degrees(Math.atan2(-m20, cosine)),
    roll_deg: locked ? 0 : degrees(Math.atan2(m21, m22)) };
}

// Geodesic angle between two orientations, degrees.
export function angleBetween(a, b) {
  const dot = Math.abs(a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z);
  return (2 * Math.acos(Math.min(1, dot)) * 180) / Math.PI;
}

function stageMatrix(stage, jointValue) {
  const value = stage.ratio * jointValue;
  const axis = new Vector3(...stage.axis);
  if (stage.kind === "prismatic") return new Matrix4().makeTranslation(axis.multiplyScalar(value));
  const origin = new Vector3(...stage.origin);
  return new Matrix4()
    .makeTranslation(origin)
    .multiply(new Matrix4().makeRotationAxis(axis, (value * Math.PI) / 180))
    .multiply(new Matrix4().makeTranslation(origin.negate()));
}

// Part name -> its motion with these joint values. Deeper stages act first; `stages` is sorted that way.
export function partMotions(stages, values) {
  const motions = new Map();
  for (const stage of stages) {
    const moved = stageMatrix(stage, values[stage.joint] ?? stage.initial);
    for (const part of stage.parts) {
      const before = motions.get(part);
      motions.set(part, before ? moved.clone().multiply(before) : moved);
    }
  }
  return motions;
}
