// A model as the tracker prepared it: its parts from mesh.glb, its joints from the model's document.
import { Box2, BufferAttribute, BufferGeometry, Group, Mesh, Vector2, Vector3 } from "../vendor/three/three.module.min.js";
import { partMotions, quaternionOf } from "./rotation.js";

const bodies = new Map();

export function loadBody(api, modelId) {
  if (!bodies.has(modelId)) {
    const loading = fetchBody(api, modelId);
    bodies.set(modelId, loading);
    loading.catch(() => bodies.delete(modelId)); // asked for again the next time
  }
  return bodies.get(modelId);
}

async function fetchBody(api, modelId) {
  const [model, glb] = await Promise.all([
    api.json(`/v1/models/${modelId}`),
    api.bytes(`/v1/models/${modelId}/mesh.glb`),
  ]);
  return new Body(model, readGlb(glb));
}

export class Body {
  constructor(model, parts) {
    this.model = model;
    this.parts = parts;
    this.radius = Math.max(...parts.map((part) => farthest(part.geometry)));
    this.stages = model.joints
      .flatMap((joint) => joint.stages.map((stage) => ({
        ...stage,
        joint: joint.name,
        initial: joint.initial,
        origin: stage.origin.map((value, i) => value - model.centre[i]), // file coordinates -> body frame
      })))
      .sort((a, b) => b.depth - a.depth);
    this.moving = new Set(this.stages.flatMap((stage) => stage.parts));
  }

  // A group of one mesh per part; `material(part, moves)` gives each its look.
  instance(material) {
    const group = new Group();
    for (const part of this.parts) {
      const mesh = new Mesh(part.geometry, material(part, this.moving.has(part.name)));
      mesh.name = part.name;
      mesh.matrixAutoUpdate = false;
      group.add(mesh);
    }
    return group;
  }

  setJoints(group, values) {
    const motions = partMotions(this.stages, values);
    for (const mesh of group.children) {
      const motion = motions.get(mesh.name);
      if (motion) mesh.matrix.copy(motion);
    }
  }

  // The rectangle of the image that a pose fills, px: that of its parts' bounding boxes, so a little too large.
  box(pose) {
    const motions = partMotions(this.stages, pose.joints), turn = quaternionOf(pose.orientation), box = new Box2();
    const corner = new Vector3(), at = new Vector2();
    for (const { name, geometry } of this.parts) {
      if (!geometry.boundingBox) geometry.computeBoundingBox();
      const { min, max } = geometry.boundingBox, motion = motions.get(name);
      for (let k = 0; k < 8; k++) {
        corner.set(k & 1 ? min.x : max.x, k & 2 ? min.y : max.y, k & 4 ? min.z : max.z);
        if (motion) corner.applyMatrix4(motion);
        corner.applyQuaternion(turn).multiplyScalar(pose.scale_px);
        box.expandByPoint(at.set(corner.x + pose.x_px, corner.y + pose.y_px));
      }
    }
    return box;
  }
}

function farthest(geometry) {
  const points = geometry.getAttribute("position").array;
  let most = 0;
  for (let i = 0; i < points.length; i += 3) {
    most = Math.max(most, points[i] ** 2 + points[i + 1] ** 2 + points[i + 2] ** 2);
  }
  return Math.sqrt(most);
}

// GLB of service/models/mesh_glb.py: plain accessors, one primitive per mesh.
export function readGlb(buffer) {
  const view = new DataView(buffer);
  const jsonLength = view.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, jsonLength)));
  const start = 20 + jsonLength + 8;
  const array = (index, Type, size) => {
    const accessor = document.accessors[index];
    const { byteOffset } = document.bufferViews[accessor.bufferView];
    return new Type(buffer, start + byteOffset, accessor.count * size);
  };
  return document.nodes.map((node) => {
    const { attributes, indices } = document.meshes[node.mesh].primitives[0];
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(array(attributes.POSITION, Float32Array, 3), 3));
    geometry.setIndex(new BufferAttribute(array(indices, Uint32Array, 1), 1));
    return { name: node.name, geometry };
  });
}
