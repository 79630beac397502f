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
