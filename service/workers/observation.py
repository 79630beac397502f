"""What a frame says, given what earlier frames taught; and what this frame teaches the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.imaging.background import Sky
from service.imaging.decode import Frame as Image
from service.imaging.measurement import FrameMaps, log_constant, measure
from service.imaging.region import Region, first_region, learn_region, region_log_ratio
from service.inference.params import SessionConfig
from service.inference.tracking import ESTABLISHED_FRAMES, renewal_due

Memory = Mapping[str, NDArray[np.generic]]

_PSF_FADE = 0.8  # per frame, of the running average of the point-spread width


@dataclass(frozen=True)
class Observation:
    """Maps of a frame, with what they were made from."""

    maps: FrameMaps
    region: Region | None  # distributions around the object, where there is no empty frame


def observe(image: Image, sky: Sky, config: SessionConfig, memory: Memory) -> Observation:
    """Measure a frame with the session's likelihood."""
    likelihood = config.likelihood
    if likelihood.kind == "contrast" and not sky.per_pixel:
        region = _remembered_region(memory)
        log_background = log_constant(image.image, sky)
        if region is None:
            region = first_region(image.image, image.bits, sky.known)
            log_ratio = region_log_ratio(image.image, image.bits, region)
            log_ratio[sky.known] = np.minimum(log_ratio[sky.known], -1.0)  # it was told that no object is there
        else:
            log_ratio = region_log_ratio(image.image, image.bits, region)
        return Observation(FrameMaps(log_ratio, log_background, None), region)
    age = float(np.asarray(memory.get("age", 0.0)))
    # Where the whole space is searched unlike prices are right: they find bodies that are half in shadow.
    searched = age < ESTABLISHED_FRAMES or renewal_due(age)
    maps = measure(
        image.image,
        sky,
        kind=likelihood.kind,
        psf_sigma_px=config.camera.psf_sigma_px,
        usual_psf_sigma_px=float(np.asarray(memory["psf_sigma_px"])) if "psf_sigma_px" in memory else None,
        covered_empty_nats=likelihood.covered_empty_nats,
        uncovered_bright_nats=likelihood.uncovered_bright_nats,
        edge_nats_per_px=None if searched else likelihood.edge_nats_per_px,
    )
    return Observation(maps, None)


def remember(
    observation: Observation, image: Image, memory: Memory, tracked: bool, draw: Callable[[], NDArray[np.bool_]]
) -> Memory:
    """``memory`` with what this frame adds to it; ``draw`` makes the mask (H, W) of the best silhouette.

    The distributions around the object are learned only while it is tracked: a lost track must not teach.
    """
    kept = dict(memory)
    width = observation.maps.psf_sigma_px
    if width is not None and tracked:
        usual = float(np.asarray(kept.get("psf_sigma_px", width)))
        kept["psf_sigma_px"] = np.array(_PSF_FADE * usual + (1 - _PSF_FADE) * width)
    if observation.region is not None:
        region = observation.region
        if tracked:
            region = learn_region(region, image.image, image.bits, draw())
        kept["region_foreground"], kept["region_background"] = region.foreground, region.background
    return kept


def _remembered_region(memory: Memory) -> Region | None:
    if "region_foreground" not in memory:
        return None
    return Region(
        np.asarray(memory["region_foreground"], dtype=np.float32),
        np.asarray(memory["region_background"], dtype=np.float32),
    )
