"""The model's image of a frame: what a body in the Sun looks like, and what a wrong pose leaves over."""

from dataclasses import replace

import cv2
import lit_body
import numpy as np
import pytest

from service.imaging.decode import Frame
from service.imaging.features import feature_spec
from service.imaging.overlay import draw_left_over
from service.imaging.sky import Sky
from service.inference.params import SessionConfig
from service.inference.pose import exp_so3, multiply
from service.workers.base import OverlayJob
from service.workers.pictures import LitPictures

SIZE, LEVEL, NOISE = (160, 200), 20.0, 1.5  # height and width of the frame


@pytest.fixture(scope="module")
def pictures():
    kept = LitPictures(2)
    yield kept
    kept.close()


def frame(pose, blur=0.0) -> Frame:
    """8 bits of a body in the Sun before a level sky; ``blur`` (px) by the air."""
    light = lit_body.seen(pose, lit_body.shares(lit_body.lit_body(), 150.0))
    image, x, y = np.zeros(SIZE), *(int(v) for v in lit_body.VIEW.origin)
    image[y : y + lit_body.SIDE, x : x + lit_body.SIDE] = light
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    image += np.random.default_rng(3).normal(LEVEL, NOISE, SIZE)
    return Frame(image.clip(0, 255).round().astype(np.uint8), 8, 1)


def sky() -> Sky:
    spec = feature_spec("intensity", 1, 8, 1.0)
    return Sky(np.full((*SIZE, 1), LEVEL, np.float32), np.array([[NOISE**2]]), np.zeros(spec.n_bins), spec)


def job(pose, sun=lit_body.SUN) -> OverlayJob:
    _, articulation = lit_body.lit_mesh()
    return OverlayJob(
        model="lit",
        file_type="glb",
        articulation=articulation,
        body=b"",
        media_type="image/png",
        quaternion=pose.quaternion[0],
        position=pose.position[0],
        scale=float(np.exp(pose.log_scale[0])),
        joints=pose.joints[0],
        config=SessionConfig(),
        background="sky",
        sun=sun,
    )


def left_over(pictures, image, asked) -> float:
    """Mean of the residual's colour over the frame."""
    mesh, _ = lit_body.lit_mesh()
    return float(pictures.draw(asked, image, sky(), mesh)["residual"].max(axis=2).mean())


@pytest.mark.parametrize("blur", [0.0, 3.0])
def test_the_model_looks_like_the_frame(pictures, blur):
    """Where all is blurred, the patch is coarser."""
    pose = lit_body.pose()
    image, (mesh, _) = frame(pose, blur), lit_body.lit_mesh()
    model = pictures.draw(job(pose), image, sky(), mesh)["model"][:, :, 0].astype(float)
    blurred = cv2.GaussianBlur(image.image.astype(np.float32), (0, 0), 1.0)
    assert np.corrcoef(model.ravel(), blurred.ravel())[0, 1] > 0.98


@pytest.mark.parametrize("sun", [lit_body.SUN, None])
def test_the_right_pose_leaves_least(pictures, sun):
    pose = lit_body.pose()
    turned = replace(pose, quaternion=multiply(exp_so3(np.array([[0.0, 0.0, 0.6]])), pose.quaternion))
    image = frame(pose)
    right, wrong = (left_over(pictures, image, job(one, sun)) for one in (pose, turned))
    assert wrong > 1.9 * right  # of which nothing is left but noise


def test_a_binned_region_is_drawn_in_its_place(pictures):
    pose = lit_body.pose()
    whole = frame(pose)
    x, y = (int(v) for v in lit_body.VIEW.origin)
    camera = replace(SessionConfig().camera, roi=(x - 8, y - 8, 80, 80), binning=2)
    asked = replace(job(pose), config=replace(SessionConfig(), camera=camera))
    part = replace(sky(), mean=np.full((40, 40, 1), LEVEL, np.float32))
    drawn = pictures.draw(asked, whole, part, lit_body.lit_mesh()[0])["model"]
    assert drawn.shape == (*SIZE, 3)
    assert drawn[: y - 8].max() == drawn[:, : x - 8].max() == 0
    full = pictures.draw(job(pose), whole, sky(), lit_body.lit_mesh()[0])["model"]
    inside = (slice(y, y + lit_body.SIDE), slice(x, x + lit_body.SIDE), 0)
    assert np.corrcoef(drawn[inside].ravel().astype(float), full[inside].ravel().astype(float))[0, 1] > 0.9


def test_light_that_is_left_and_light_that_is_missing_are_told_apart():
    more, nothing, less = draw_left_over(np.array([[0.5, 0.0, -3.0]]))[0].tolist()
    assert nothing == [0, 0, 0]
    assert more[0] > more[2] and less[2] > less[0]
    assert less[2] == 255
