"""The wire: what a frame shows, and how well a model explains it (docs/model.md, section 6)."""

from __future__ import annotations

from typing import Literal

from service.api.wire import Wire

Status = Literal["acquiring", "tracking", "ambiguous", "no_fit", "lost", "no_target"]


class Probabilities(Wire):
    """Of what a frame may show; their sum is 1."""

    absent: float
    """Nothing is there."""
    fits: float
    """This model, at one of the modes."""
    no_fit: float
    """Something that this model does not explain."""


class Fit(Wire):
    """How well a mode explains the light."""

    chi2: float
    """Mean square of what is left over on the body, in units of what noise and a usual discrepancy allow."""
    explained: float
    """Share of the light."""
    covered_dark: float
    """Share of the silhouette that shows no light."""


class RankedModel(Wire):
    """A model that the object may be."""

    model_id: str
    probability: float
    """Given all frames so far, where all models were equally probable before."""
    log_evidence: float
    """Sum over the frames so far."""
