"""What a session is told of a pass beside its frames: where the Sun is, how large the body, and how well known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from service.bench.altered import altered
from service.bench.brightness import pixels, to_power
from service.bench.canvas import on_canvas
from service.bench.cases import Case, TruthFrame
from service.bench.cut import cut_off
from service.bench.early import begun_early
from service.bench.guided import by_hand
from service.inference.light import Light
from service.inference.params import SessionConfig
from service.inference.pose import exp_so3, rotation_matrices
from service.inference.state import Array
from service.simulate.folder import encode_png

_ANY_DIRECTION = np.array([0.3, -0.5, 0.8])


@dataclass(frozen=True)
class Told:
    """A choice for all passes. A pass that does not know its Sun or its scale tells nothing of it."""

    sun: bool = True
    sun_off_deg: float = 0.0  # told wrongly by so much
    scale: bool = False
    sky: bool = True  # empty frames; else it is learned from the frames themselves
    stretch: float | None = None  # the frames' counts are the light to this power, and that is told
    mesh_error: bool = True
    canvas: int | None = None  # the frames lie in the midst of an image of this side, px
    cut: float | None = None  # share of the body that lies beyond the image's lower edge
    guided: int | None = None  # every frame is moved by up to so many px, as by hand
    early: int | None = None  # frames of empty sky ahead of the pass
    every: int | None = None  # only one frame in so many: a slow camera, or a client that posts few
    altered: str | None = None  # one of ``altered.ALTERATIONS``: what a program did to the frames, and nobody tells

    def configure(self, config: SessionConfig, case: Case) -> SessionConfig:
        """A session's configuration with what it is told. What was set already stays as it is."""
        if self.sun and case.towards_sun is not None and config.light.sun == "auto":
            x, y, z = turned(case.towards_sun, self.sun_off_deg).tolist()
            config = replace(config, light=replace(config.light, sun=(x, y, z)))
        if self.scale and case.scale_prior is not None and config.prior.scale_px is None:
            px, sigma = case.scale_prior
            config = replace(config, prior=replace(config.prior, scale_px=px, scale_sigma=sigma))
        if self.mesh_error and case.mesh_error and config.prior.mesh_error == 0:
            config = replace(config, prior=replace(config.prior, mesh_error=case.mesh_error))
        if self.stretch is not None:
            config = replace(config, camera=replace(config.camera, transfer=self.stretch))
        return config

    def light_at(self, truth: TruthFrame) -> Light | None:
        """What a session is told of a frame's light beside its configuration."""
        light = truth.light if self.sun else None
        if light is None or light.towards_sun is None or not self.sun_off_deg:
            return light
        x, y, z = turned(np.array(light.towards_sun), self.sun_off_deg).tolist()
        return replace(light, towards_sun=(x, y, z))

    def shown(self, case: Case) -> Case:
        """The case as a camera would show it that is slow, begins early, sees more of the sky or less of the body, or
        stretches light, and as a program would leave it.
        """
        if self.every is not None:
            case = _thinned(case, self.every)
        if self.early is not None:
            case = begun_early(case, self.early)
        if self.canvas is not None:
            case = on_canvas(case, self.canvas)
        if self.cut is not None:
            case = cut_off(case, self.cut)
        if self.guided is not None:
            case = by_hand(case, self.guided)
        if self.stretch is not None:
            case = _stretched(case, self.stretch)
        return case if self.altered is None else altered(case, self.altered)


def _thinned(case: Case, every: int) -> Case:
    return replace(case, frames=lambda: islice(case.frames(), 0, None, every))


def _stretched(case: Case, power: float) -> Case:
    return replace(
        case,
        backgrounds=lambda: (stretched(body, power) for body in case.backgrounds()),
        frames=lambda: ((stretched(body, power), truth) for body, truth in case.frames()),
    )


def stretched(body: bytes, power: float) -> bytes:
    """A PNG whose counts are those of another to a power, both as shares of full scale."""
    return encode_png(to_power(pixels(body), power))


def turned(direction: Array, degrees: float) -> Array:
    """(3,) unit vector: a direction turned about an axis across it."""
    unit = direction / np.linalg.norm(direction)
    across = np.cross(unit, _ANY_DIRECTION)
    turn = exp_so3(np.deg2rad(degrees) * across / np.linalg.norm(across))
    return np.asarray(rotation_matrices(turn) @ unit, dtype=np.float64)
