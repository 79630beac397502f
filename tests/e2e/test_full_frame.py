"""A session with a window answers as one that was sent the cut-out itself, in pixels of the whole frame."""

import cv2
import numpy as np
import pytest
from passes import box_pass

from service.errors import ConfigError, ImageMismatchError
from service.inference.params import CameraParams
from service.sessions.config import effective
from service.sessions.particle_set import ParticleSet
from service.workers.base import BackgroundJob, FrameJob, ModelJob, SmoothJob
from service.workers.codec import encode
from service.workers.tracker import Tracker, content_key

GIVEN = box_pass(3, 48)
SMALL = {"filter": {"particles": 150}}
ROI, BINNING = [10, 6, 97, 96], 2  # 97: one column is left over


def pixels(body: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)


def in_a_larger_frame(body: bytes, fill: int) -> bytes:
    whole = np.full((120, 140), fill, np.uint8)
    whole[6:102, 10:106] = np.kron(pixels(body), np.ones((2, 2), np.uint8))
    return cv2.imencode(".png", whole)[1].tobytes()


def track(images: list[bytes], background: list[bytes], camera: dict, scale_px=None):
    """Background and reports of a short pass, and the smoothed estimates."""
    tracker = Tracker()
    config = effective({**SMALL, "camera": camera})
    model = tracker.prepare_model(ModelJob(GIVEN.mesh, "stl"))
    learned, size = None, None
    for body in background:
        report = tracker.learn_background(BackgroundJob(config, body, "image/png", learned, size=size))
        learned, size = report.background, (report.width, report.height)
    blobs = {content_key(GIVEN.mesh): GIVEN.mesh, "sky": learned}
    state, reports = None, []
    for k, body in enumerate(images):
        job = FrameJob(
            config, content_key(GIVEN.mesh), "stl", model.articulation, "sky", state, k, 0.1 * k, body, "image/png",
            blobs, model.twins, size=size, scale_px=scale_px,
        )  # fmt: skip
        reports.append(tracker.track(job))
        state = reports[-1].state
    beliefs = tuple(encode(report.belief) for report in reports)
    smooth = tracker.smooth(SmoothJob(config, model.articulation, model.twins, *size, beliefs, len(reports)))
    tracker.close()
    return size, reports, smooth.estimates


@pytest.fixture(scope="module")
def both():
    alone = track(GIVEN.frames, GIVEN.background, {"psf_sigma_px": 1.0})
    images, sky = ([in_a_larger_frame(b, fill) for b in g] for g, fill in ((GIVEN.frames, 255), (GIVEN.background, 3)))
    camera = {"psf_sigma_px": 2.0, "roi": ROI, "binning": BINNING}
    return alone, track(images, sky, camera)


def assert_same(alone, whole) -> None:
    for name in ("mean", "best"):
        a, w = getattr(alone, name), getattr(whole, name)
        np.testing.assert_array_equal(w.quaternion, a.quaternion)
        np.testing.assert_allclose(w.position, 2 * a.position + [10, 6])
        assert w.scale == pytest.approx(2 * a.scale)
    a, w = alone.spread, whole.spread
    assert (w.orientation_deg, w.x_px, w.scale_px) == pytest.approx((a.orientation_deg, 2 * a.x_px, 2 * a.scale_px))
    units = np.diag([1, 1, 1, 2, 2, 1])
    np.testing.assert_allclose(w.covariance, units @ a.covariance @ units)
    for one, other in zip(alone.modes, whole.modes, strict=True):
        np.testing.assert_allclose(other.pose.position, 2 * one.pose.position + [10, 6])


def test_estimates_are_those_of_the_cut_out(both):
    (small, alone, _), (large, whole, _) = both
    assert (small, large) == ((48, 48), (140, 120))
    for a, w in zip(alone, whole, strict=True):
        assert_same(a.estimate, w.estimate)
        np.testing.assert_array_equal(a.state.poses.position, w.state.poses.position)


def test_particles_too(both):
    (_, alone, _), (_, whole, _) = both
    camera = CameraParams(roi=tuple(ROI), binning=BINNING)
    small, large = (
        ParticleSet(0, encode(report.state), (), params).arrays(50)
        for report, params in ((alone[0], CameraParams()), (whole[0], camera))
    )
    np.testing.assert_allclose(large["position_px"], 2 * small["position_px"] + [10, 6])
    np.testing.assert_allclose(large["scale_px"], 2 * small["scale_px"])


def test_smoothed_estimates_too(both):
    (_, _, alone), (_, _, whole) = both
    for a, w in zip(alone, whole, strict=True):
        assert_same(a, w)


def test_a_known_scale_is_kept_to():
    """Bounds beside the true scale, 24 px of the whole frame: every particle with a weight lies within them."""
    images, sky = ([in_a_larger_frame(b, 3) for b in given] for given in (GIVEN.frames[:2], GIVEN.background))
    camera = {"roi": ROI, "binning": BINNING}
    _, reports, _ = track(images, sky, camera, (26.0, 27.0))
    for report in reports:
        assert 26.0 <= report.estimate.best.scale <= 27.0
        scales = BINNING * np.exp(report.state.poses.log_scale[report.state.log_weights > -100])
        assert scales.min() >= 26.0 - 1e-9 and scales.max() <= 27.0 + 1e-9


def test_frames_of_another_size_are_refused_although_the_region_lies_in_them():
    camera = {"roi": [0, 0, 40, 40]}
    other = cv2.imencode(".png", np.zeros((60, 60), np.uint8))[1].tobytes()
    with pytest.raises(ImageMismatchError, match="60 x 60"):
        track([other], GIVEN.background, camera)
    with pytest.raises(ConfigError, match="outside"):
        track([], GIVEN.background, {"roi": [0, 0, 49, 10]})
    with pytest.raises(ConfigError):
        effective({"camera": {"roi": [-1, 0, 4, 4]}})
