"""Frames of sessions whose method is ``mixture``: bodies, banks of templates and light, kept between frames."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from gpu.mesh import Mesh
from service.imaging.decode import Frame as Image
from service.imaging.sky import Sky
from service.inference.articulation import Articulation
from service.inference.belief import Belief, belief_of_mixture
from service.inference.clutter.step import Surroundings
from service.inference.clutter.step import step as step_before_clutter
from service.inference.domain import Domain
from service.inference.filters.given import Given
from service.inference.filters.mixture import step
from service.inference.light import Light
from service.inference.model.drawing import FINE, Lens
from service.inference.model.paint import unlearnt
from service.inference.model.prior import EVEN_MEAN, LightPrior, earthlight
from service.inference.model.search import make_bank
from service.inference.model.stages import Body
from service.inference.model.sun_tracking import SunTracking
from service.inference.model.templates import Bank
from service.inference.numerics.priors import PosePrior
from service.inference.params import SessionConfig
from service.inference.state import Estimate, FilterState
from service.inference.symmetry import Symmetry
from service.workers.base import FrameJob, ReadyJob
from service.workers.cache import Cache
from service.workers.cluttered_frame import ClutteredFrame, Lifting
from service.workers.full_frame import in_full_frame, in_window, scale_in_window
from service.workers.lit_body import LitBody
from service.workers.lit_frame import LightOfFrame, known_span, region_of
from service.workers.panels import sun_tracking
from service.workers.smoothing import with_rates

_BANKS, _BANK_BYTES = 8, 1 << 28  # 29 MB each, 87 of a body with two joints
_SAME_SUN_RAD = 0.05  # templates 12 degrees apart do not feel it
_SAME_AROUND = 0.1  # of the Earth's light: nor this
_LEAST_SUNLIT = 0.01  # numerical: of the Sun's disc: in its last crescent all light is the Earth's
_ANY_SUN_RAD = 1.0  # what is believed of a Sun that is not told: it is searched


class Following:
    """Owned and used by one thread. Raises ``gpu.errors.DeviceError`` where there is no OpenCL."""

    def __init__(self, size: int) -> None:
        self._bodies: Cache[LitBody] = Cache(size, lambda body: body.close())
        self._tracking: Cache[SunTracking | None] = Cache(size)
        self._banks: Cache[_Kept] = Cache(_BANKS, weigh=lambda kept: kept.bank.nbytes, most_bytes=_BANK_BYTES)

    def track(
        self,
        job: FrameJob,
        image: Image,
        sky: Sky,
        mesh: Mesh,
        articulation: Articulation,
        twins: tuple[Symmetry, ...],
        lens: Lens | None = None,
    ) -> tuple[FilterState, Estimate, Belief | None]:
        """The posterior after a frame, the answer in pixels of the whole frame, and what the smoother keeps."""
        config = in_window(job.config)
        height, width = image.image.shape[:2]
        within = scale_in_window(job.scale_px, job.config.camera)
        domain = Domain(width, height, mesh.radius, articulation, config.prior, within)
        key, body, tracking = self._known(job.model, config, mesh, articulation)
        told = replace(told_of(config, domain, job.light), tracking=tracking)
        rng = stream_of(config.filter.seed, job.frame_index)
        if sky.clutter is not None:
            frame = ClutteredFrame.of(image.image, sky.clutter, job.state, lens)
            lift, where = Lifting(mesh, articulation, lens), sky.clutter
            about = frame, body.middle, where, lift, told, config, domain, twins, lens, n_paint(body)
            given_here = Surroundings(*about, job.frame_index, job.time_s, job.held)
            told_of_it = step_before_clutter(rng, job.state, given_here)
            return self._told(job, config, domain, *told_of_it)
        region = region_of(job.state, job.time_s, mesh.radius, (height, width), config.prior.mesh_error)
        known = region, lens, known_span(job.state)
        light = LightOfFrame(image.image, sky, image.bits, config.camera.psf_sigma_px, *known)
        bank = partial(self._bank, key, body, told)
        given = Given(light, body, bank, told, config, domain, twins, job.frame_index, job.time_s, job.held)
        state, estimate = step(rng, of_body(job.state, body), given)
        span = light.span_px
        estimate = replace(estimate, light_scale=None if span is None else span / (2 * mesh.radius))
        return self._told(job, config, domain, state, estimate)

    @staticmethod
    def _told(
        job: FrameJob, config: SessionConfig, domain: Domain, state: FilterState, estimate: Estimate
    ) -> tuple[FilterState, Estimate, Belief | None]:
        """With rates, in pixels of the whole frame, and with what the smoother keeps."""
        belief = None if state.mixture is None else belief_of_mixture(state, state.mixture)
        if job.state is not None and config.motion.kind == "constant_velocity":
            estimate = with_rates(estimate, state, belief, domain)
        return state.to_show(), in_full_frame(estimate, job.config.camera), belief

    def ready(self, job: ReadyJob, mesh: Mesh, articulation: Articulation) -> None:
        """Prepare what a session's frames will need: the body, and its templates where their Sun is known already."""
        config = in_window(job.config)
        key, body, tracking = self._known(job.model, config, mesh, articulation)
        told = replace(sun_of(config, job.light), tracking=tracking)
        if told.towards_sun is not None:
            self._bank(key, body, told)

    def close(self) -> None:
        """Give the device's memory back."""
        self._banks.clear()
        self._bodies.clear()

    def _known(
        self, model: str, config: SessionConfig, mesh: Mesh, articulation: Articulation
    ) -> tuple[str, Body, SunTracking | None]:
        """A body, which of its joints track the Sun, and the key that tells it from others."""
        key = f"{model}:{articulation}"
        body = self._bodies.get(key, lambda: LitBody(mesh, articulation)).body
        key += f":{config.joints.sun_tracking}:{config.joints.sun_tracking_sigma_deg}"
        return key, body, self._tracking.get(key, lambda: sun_tracking(mesh, articulation, config.joints))

    def _bank(self, key: str, body: Body, told: PosePrior) -> Bank:
        """The templates of a body, made anew when the Sun has moved."""
        kept = self._banks.get(key, lambda: _Kept(told, make_bank(body, told)))
        if not kept.serves(told):
            self._banks.forget(key)
            kept = self._banks.get(key, lambda: _Kept(told, make_bank(body, told)))
        return kept.bank


def stream_of(seed: int, index: int) -> np.random.Generator:
    """The random numbers of a frame: of the session's seed and its own index alone."""
    return np.random.Generator(np.random.Philox(key=np.array([seed, index], np.uint64)))


class _Kept:
    """A bank, and the light that it is of."""

    def __init__(self, told: PosePrior, bank: Bank) -> None:
        self.bank, self._sun, self._around = bank, told.towards_sun, np.array(told.light.around)

    def serves(self, told: PosePrior) -> bool:
        sun, around = told.towards_sun, np.array(told.light.around)
        if sun is None or self._sun is None:
            return sun is None and self._sun is None
        off = np.linalg.norm(around - self._around) / max(float(np.linalg.norm(self._around)), EVEN_MEAN)
        return float(np.linalg.norm(sun - self._sun)) < _SAME_SUN_RAD and float(off) < _SAME_AROUND


def n_paint(body: Body) -> int:
    """Numbers that are learnt of a body's surfaces."""
    return body.fine.n_planes(FINE)


def of_body(state: FilterState | None, body: Body) -> FilterState | None:
    """A state whose modes know as many surfaces as the body has: another version may have cut it otherwise."""
    fresh = unlearnt(n_paint(body))
    if state is None or state.mixture is None or state.mixture.paint.shape[-1] == fresh.shape[-1]:
        return state
    fresh = np.tile(fresh, (len(state.mixture.poses), 1, 1))
    displaced = state.mixture.displaced
    displaced = None if displaced is None else replace(displaced, was=None)
    return replace(state, mixture=replace(state.mixture, paint=fresh, displaced=displaced))


def told_of(config: SessionConfig, domain: Domain, light: Light | None) -> PosePrior:
    """What is known of a pose and of the Sun beside the frame, in pixels of the window."""
    told = sun_of(config, light)
    scale, binning = config.prior.scale_px, config.camera.binning
    if scale is not None:
        return replace(told, log_scale=float(np.log(scale / binning)), log_scale_sigma=config.prior.scale_sigma)
    if domain.scale_within is not None:  # three standard deviations either side
        low, high = domain.log_scale_bounds
        return replace(told, log_scale=0.5 * (low + high), log_scale_sigma=max((high - low) / 6, 1e-3))
    return told


def sun_of(config: SessionConfig, light: Light | None) -> PosePrior:
    """What is known of the Sun beside the frame."""
    told = PosePrior(sun_sigma=_ANY_SUN_RAD)
    if light is None or light.towards_sun is None:
        return told
    x, y, z = light.towards_sun
    sun = np.array([x, y, -z if light.mirrored else z])
    sigma = float(np.deg2rad(config.light.sun_sigma_deg)) if light.sigma_rad is None else light.sigma_rad
    return replace(told, towards_sun=sun / np.linalg.norm(sun), sun_sigma=sigma, light=earthlight_of(light))


def earthlight_of(light: Light) -> LightPrior:
    """What is known of the light beside the Sun's: by how much of that the Earth dims, the Earth's is more."""
    if light.earth is None or light.earthshine is None or light.earth_aside is None or not light.earthshine:
        return LightPrior()
    x, y, z = light.earth
    strength = light.earthshine / max(1.0 if light.sunlit is None else light.sunlit, _LEAST_SUNLIT)
    return earthlight((x, y, -z if light.mirrored else z), strength, light.earth_aside)
