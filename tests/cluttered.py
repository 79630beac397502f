"""A body of a texture of its own before a ground that moves: frames, drawn by the way back from places to the body."""

from dataclasses import dataclass

import cv2
import numpy as np
from lit_body import box

from gpu.mesh import assemble
from service.imaging.background import known_pixels, learn
from service.imaging.features import feature_spec
from service.imaging.sky import Sky, derive
from service.inference.articulation import Articulation
from service.inference.model.drawing import Lens
from service.inference.pose import exp_so3, multiply
from service.inference.state import Poses
from service.workers.cluttered_frame import Lifting

SIZE = 192
LENS = Lens(400.0, (96.0, 96.0))
# no turn brings it to itself
MESH = assemble([box("bus", (1.0, 1.5, 0.8), (0, 0, 0)), box("mast", (0.3, 0.4, 1.2), (0.3, 0.5, 0.9))])
FIXED = Articulation(("bus", "mast"), ())


@dataclass(frozen=True)
class Scene:
    """Frames (H, W, 3), poses, where the body is seen (H, W), and the sky of frame 1 with a box about it."""

    frames: list[np.ndarray]
    poses: list[Poses]
    masks: list[np.ndarray]
    box: tuple[int, int, int, int]
    sky: Sky


def pose(step: float) -> Poses:
    """A pose (1) that turns by 3 degrees a step, and drifts."""
    turned = multiply(exp_so3(np.array([[0.5, -0.6, 0.3]])), exp_so3(np.array([[0.0, 0.05 * step, 0.02 * step]])))
    place = np.array([[92.0 + 2 * step, 98.0 - step]])
    return Poses(turned, place, np.array([np.log(62.0)]), np.zeros((1, 0)))


def scene(count: int, seed: int = 0, lens: Lens | None = LENS) -> Scene:
    """``count`` frames, three degrees apart."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.uniform(0, 255, (300, 300, 3)).astype(np.float32), (0, 0), 4)
    ground = 90 + 5 * (ground - ground.mean()) * np.array([0.6, 0.8, 1.0], np.float32)
    cells = rng.uniform(60, 230, (3, 8, 8, 8))
    frames, poses, masks = [], [pose(float(k)) for k in range(count)], []
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    for k, one in enumerate(poses):
        on_body = Lifting(MESH, FIXED, lens)(one, np.column_stack([x.ravel(), y.ravel()]))
        cell = np.floor(5 * on_body.points + 0.01).astype(int) % 8
        seen = (on_body.part >= 0).reshape(SIZE, SIZE)
        paint = cells[:, cell[:, 0], cell[:, 1], cell[:, 2]].T.reshape(SIZE, SIZE, 3) * np.array([1.0, 0.8, 0.3])
        image = np.where(seen[..., None], paint, ground[3 * k :, 2 * k :][:SIZE, :SIZE])
        image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.8) + rng.normal(0, 2, image.shape)
        frames.append(np.clip(image, 0, 255).astype(np.uint8))
        masks.append(seen)
    rows, columns = np.nonzero(masks[0])
    told = int(columns.min()) - 6, int(rows.min()) - 6, int(np.ptp(columns)) + 13, int(np.ptp(rows)) + 13
    spec = feature_spec("auto", 3, 8, 1.0)
    sky = derive(learn(None, frames[0], 8, spec, known_pixels(SIZE, SIZE, told, None)), "auto", 1.0)
    return Scene(frames, poses, masks, told, sky)
