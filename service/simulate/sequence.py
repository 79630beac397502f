"""A scenario and a mesh -> background images, frames and the truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from service.inference.articulation import Articulation
from service.simulate.atmosphere import Atmosphere
from service.simulate.camera import Image, Sensor
from service.simulate.motion import Track, plan_track
from service.simulate.overflight import follow, seen, told
from service.simulate.path_tracing import PathTracer
from service.simulate.render import Light, Picture, Renderer
from service.simulate.scenario import Scenario
from service.simulate.wrong_mesh import misshapen

_MOTION, _PAINT, _AIR, _STARS, _NOISE, _BACKGROUND_NOISE, _RANGE, _SHAPE = range(8)
_OWN = (_AIR, _STARS, _NOISE, _BACKGROUND_NOISE, _RANGE)  # each telescope's
RANGE_ERROR = 0.03  # relative, of a scale that a range, a plate scale and the mesh's unit make


class SimulatedPass:
    """One pass. Its images are made when they are asked for; every iteration makes the same ones.

    Raises ``PathTracingMissingError`` where one is to be path-traced and Mitsuba is not installed.
    """

    def __init__(self, mesh: Mesh, articulation: Articulation, scenario: Scenario) -> None:
        self.scenario = scenario
        self.mesh = mesh
        self.articulation = articulation
        track = plan_track(
            scenario.motion,
            articulation,
            mesh.radius,
            scenario.size,
            self._rng(_MOTION),
            scenario.air.image_motion_px(),
        )
        over = scenario.overflight
        self.looks = [] if over is None else follow(over, track.time_s.tolist(), scenario.light)
        self.track: Track = track if over is None else seen(track, self.looks, told(over, scenario.light))
        body = misshapen(mesh, self._rng(_SHAPE), scenario.mesh_error)
        draw = PathTracer if scenario.path_traced else Renderer
        self._renderer = draw(body, articulation, self._rng(_PAINT), scenario.materials)

    @property
    def told_scale(self) -> float:
        """The first scale, px per model unit, as well as a range tells it (log-normal)."""
        error = RANGE_ERROR * self._rng(_RANGE).standard_normal()
        return float(np.exp(self.track.poses.log_scale[0] + error))

    def backgrounds(self) -> Iterator[Image]:
        """Images of empty sky, taken before the pass."""
        count = self.scenario.background_frames
        interval = self.scenario.motion.frame_interval_s
        empty = [self._empty()] * count
        times = np.arange(-count, 0, dtype=np.float64) * interval
        yield from self._exposures(empty, times, _BACKGROUND_NOISE)

    def frames(self) -> Iterator[Image]:
        """The images of the pass, in order."""
        yield from self._exposures(self._pictures(), self.track.time_s, _NOISE)

    def picture(self, index: int) -> Picture:
        """The body at a frame's true pose, as it would be seen without air and sensor."""
        if not self.track.visible[index]:
            return self._empty()
        pose = self.track.poses[index : index + 1]
        return self._renderer.render(pose, self.scenario.size, self.light(index))

    def light(self, index: int) -> Light:
        """The light of a frame."""
        return self.looks[index].light if self.looks else self.scenario.light

    def _pictures(self) -> Iterator[Picture]:
        for index in range(len(self.track.time_s)):
            yield self.picture(index)

    def _exposures(
        self, pictures: Iterator[Picture] | list[Picture], times: NDArray[np.float64], purpose: int
    ) -> Iterator[Image]:
        scenario = self.scenario
        air = Atmosphere(scenario.air, scenario.size, self._rng(_AIR, purpose))
        sensor = Sensor(scenario.camera, scenario.size, self._rng(_STARS))
        noise = self._rng(purpose)
        for picture, time_s in zip(pictures, times, strict=True):
            stars = sensor.star_layer(float(time_s), scenario.motion.frame_interval_s)
            layers = air.expose(picture.radiance, picture.coverage, stars)
            radiance, coverage, stars = layers
            light = radiance * np.float32(air.gain())
            yield sensor.read(light, coverage, stars, noise, sensor.ground_layer(float(time_s)))

    def _empty(self) -> Picture:
        nothing = np.zeros(self.scenario.size[::-1], dtype=np.float32)
        return Picture(nothing, nothing)

    def _rng(self, *purpose: int) -> np.random.Generator:
        own = (self.scenario.telescope,) if self.scenario.telescope and purpose[0] in _OWN else ()
        return np.random.default_rng([self.scenario.seed, *purpose, *own])
