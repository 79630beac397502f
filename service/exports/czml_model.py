"""The body itself in CZML: its mesh as glTF within the document, and its parts moved as the joints were.

Cesium turns what glTF calls z, x, y into its own x, y, z. A root node turned the other way (``ROOT``) leaves the mesh
in the axes of the body, to which ``orientation`` refers; node transformations act below it: they are in those axes too.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from service.exports.history import Body, Sample, Segment
from service.inference.articulation import Articulation, part_motions
from service.inference.pose import from_matrices
from service.inference.state import Array

ROOT = (-0.5, -0.5, -0.5, 0.5)  # x, y, z, w: body's x, y, z to glTF's z, x, y
_LEAST_PX = 64  # on the screen, however far away


def model_properties(body: Body, segments: tuple[Segment, ...]) -> dict[str, Any]:
    """``model`` of a packet."""
    data = base64.b64encode(body.glb).decode()
    moved = _moved_parts(body.articulation, [sample for segment in segments for sample in segment])
    return {
        "gltf": f"data:model/gltf-binary;base64,{data}",
        "scale": body.unit_m,
        "minimumPixelSize": _LEAST_PX,
        **({"nodeTransformations": moved} if moved else {}),
    }


def _moved_parts(articulation: Articulation, samples: list[Sample]) -> dict[str, Any]:
    """Of each part that a joint moves, where it went, by its node's name."""
    names, first = [joint.name for joint in articulation.joints], samples[0].time
    values = np.array([[sample.joints[name] for name in names] for sample in samples]).reshape(len(samples), -1)
    seconds = np.array([(sample.time - first).total_seconds() for sample in samples])
    epoch = first.isoformat(timespec="microseconds").replace("+00:00", "Z")
    out: dict[str, Any] = {}
    for part, motion in zip(articulation.parts, part_motions(articulation, values), strict=True):
        if motion is None:
            continue
        every = np.broadcast_to(motion, (len(samples), 4, 4))
        turned = np.roll(from_matrices(every[:, :3, :3]), -1, axis=1)  # scalar last
        flips = np.cumprod(np.where(np.sum(turned[1:] * turned[:-1], axis=1) < 0, -1.0, 1.0))
        turned[1:] *= flips[:, None]
        out[part] = {
            "translation": _sampled("cartesian", epoch, seconds, every[:, :3, 3]),
            "rotation": _sampled("unitQuaternion", epoch, seconds, turned),
        }
    return out


def _sampled(kind: str, epoch: str, seconds: Array, rows: Array) -> dict[str, Any]:
    if len(rows) == 1:
        return {kind: rows[0].tolist()}
    return {
        "epoch": epoch,
        "interpolationAlgorithm": "LINEAR",
        "interpolationDegree": 1,
        kind: np.column_stack([seconds, rows]).ravel().tolist(),
    }
