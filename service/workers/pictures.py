"""What people look at beside a frame: its silhouette, the model's image of it, and what that leaves over."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gpu.errors import DeviceError
from gpu.mesh import Mesh
from gpu.reference import silhouette_mask
from service.errors import BackendMissingError
from service.imaging.decode import Frame as Image
from service.imaging.overlay import RGB, draw_left_over, stretch_of, stretched
from service.imaging.patch import Light, Map, cut, light_of
from service.imaging.psf import estimate_psf_sigma
from service.imaging.sky import Sky
from service.imaging.transfer import linear
from service.imaging.window import Window
from service.inference.articulation import Articulation, part_transforms
from service.inference.model.drawing import Lens, View
from service.inference.model.nuisance import Nuisance, best_spread
from service.inference.model.prior import CORE_PX
from service.inference.model.stages import CLEAR, FINEST, SHARP, Body, Sight, stage_hill
from service.inference.model.templates import directions
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import looked
from service.inference.numerics.priors import PosePrior
from service.inference.pose import repeat
from service.inference.state import Array, PoseEstimate, Poses
from service.workers.base import OverlayJob, Shown
from service.workers.cache import Cache
from service.workers.full_frame import camera_window, in_window, lens_of
from service.workers.lit_body import LitBody

_SUNS = 64  # that are tried where none is known, 25 degrees apart: a picture for people, no measurement


class LitPictures:
    """Bodies of the last few models, lit as a frame asks. Owned, used and closed by one thread."""

    def __init__(self, size: int) -> None:
        self._bodies: Cache[LitBody] = Cache(size, lambda body: body.close())

    def draw(self, job: OverlayJob, whole: Image, sky: Sky, mesh: Mesh) -> dict[Shown, RGB]:
        """(H, W, 3) uint8: the ``model`` and the ``residual`` of a job.

        Raises ``BackendMissingError`` where there is no OpenCL.
        """
        config = in_window(job.config)
        height, width = whole.image.shape[:2]
        window = camera_window(config.camera, width, height)
        image = window.cut(linear(whole, config.camera.transfer))
        light = light_of(image.image, sky, image.bits)
        try:
            body = self._bodies.get(f"{job.model}:{job.articulation}", lambda: LitBody(mesh, job.articulation)).body
        except DeviceError as error:
            raise BackendMissingError(f"the model's image is drawn by OpenCL: {error}") from error
        model, low_pass_px = model_light(
            body,
            light,
            _in_window(_pose(job), window),
            job.sun,
            config.camera.psf_sigma_px,
            lens_of(job.config.camera, width, height),
        )
        low, span = stretch_of(image.image)
        left = cv2.GaussianBlur(light.image, (0, 0), low_pass_px) - model
        drawn: dict[Shown, RGB] = {
            "model": stretched(sky.mean.mean(axis=2) + model, low, span),
            "residual": draw_left_over(left / np.float32(0.5 * span)),
        }
        return {name: _in_frame(picture, window, (height, width)) for name, picture in drawn.items()}

    def close(self) -> None:
        """Give the devices' memory back."""
        self._bodies.clear()


def model_light(
    body: Body, light: Light, pose: Poses, sun: Array | None, psf_px: float | None, lens: Lens | None = None
) -> tuple[Map, float]:
    """(H, W) counts above the sky: one pose, its paint, light and point spread as they explain the frame best.

    They do so after a low pass, whose Gaussian sigma (px) is the second of what is returned.
    ``sun`` (3,) towards the Sun; None: the direction is tried out too.
    """
    width = psf_px or estimate_psf_sigma(np.asarray(np.abs(light.image) / light.sigma, np.float32)) or CORE_PX
    x, y = (float(value) for value in pose.position[0])
    span = 2 * body.fine.radius * float(np.exp(pose.log_scale[0]))
    sight = Sight(lambda *square: cut(light, *square), (x, y), span, width, lens)
    told, nuisance = PosePrior(towards_sun=sun), Nuisance(width)
    if sun is None:
        rough = stage_hill(body.middle, sight, SHARP, nuisance, told, speckle=False)
        looks = ascend(rough, repeat(pose, _SUNS), directions(_SUNS), steps=0, covariance="none")
        sun = max(looks, key=lambda look: look.log_posterior).sun
    # On CLEAR's patch: the same answer as on FINEST's within a step of the grid, at a fifth of the time.
    clear = stage_hill(body.fine, sight, CLEAR, nuisance, told, speckle=True)
    nuisance = best_spread(looked(clear, pose, sun[None]), nuisance)
    fine = stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True)
    (found,) = ascend(fine, pose, sun[None], steps=0, covariance="none")
    return _laid(found.fit.model, fine.view, light.image.shape), fine.scene.smoothing * fine.view.binning


def draw_silhouette(
    mesh: Mesh, articulation: Articulation, pose: PoseEstimate, shape: tuple[int, int], lens: Lens | None = None
) -> NDArray[np.bool_]:
    """(H, W) mask of a pose's silhouette."""
    batch = Poses(
        pose.quaternion[None], pose.position[None], np.array([np.log(pose.scale)]), np.asarray(pose.joints)[None]
    )
    return silhouette_mask(
        mesh, part_transforms(articulation, batch)[0], shape, None if lens is None else (lens.focal, *lens.middle)
    )


def _pose(job: OverlayJob) -> Poses:
    return Poses(job.quaternion[None], job.position[None], np.array([np.log(job.scale)]), job.joints[None])


def _in_window(pose: Poses, window: Window) -> Poses:
    position = (pose.position - np.array([window.x, window.y])) / window.binning
    return Poses(pose.quaternion, position, pose.log_scale - np.log(window.binning), pose.joints)


def _laid(patch_image: Map, view: View, shape: tuple[int, ...]) -> Map:
    """A patch's image on a frame (H, W) without any other light."""
    side = round(view.side * view.binning)
    large = cv2.resize(patch_image, (side, side), interpolation=cv2.INTER_LINEAR)
    out, (left, top) = np.zeros(shape, np.float32), (int(value) for value in view.origin)
    rows, columns = slice(max(top, 0), max(top + side, 0)), slice(max(left, 0), max(left + side, 0))
    height, width = out[rows, columns].shape
    first = rows.start - top, columns.start - left
    out[rows, columns] = large[first[0] : first[0] + height, first[1] : first[1] + width]
    return out


def _in_frame(picture: RGB, window: Window, shape: tuple[int, int]) -> RGB:
    """A window's picture in its place in the whole frame (H, W)."""
    out = np.zeros((*shape, 3), np.uint8)
    large = picture.repeat(window.binning, axis=0).repeat(window.binning, axis=1)
    out[window.y : window.y + window.height, window.x : window.x + window.width] = large
    return out
