"""Each part of the default filter left out, one at a time: by a session's parameters, or by its prior."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from service.inference.model import prior


class VariantError(ValueError):
    """There is no variant of that name."""


@dataclass(frozen=True)
class Variant:
    """A change of the default session. ``sections`` are laid over it; ``twins`` False hides the symmetries.

    ``priors``: values that take the place of those in ``service.inference.model.prior``. A width of next to nothing
    leaves its term out.
    """

    name: str
    says: str
    sections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    twins: bool = True
    priors: Mapping[str, Any] = field(default_factory=dict)


_NONE = 1e-4
VARIANTS = (
    Variant("default", "nothing left out"),
    Variant("gloss", "matt surfaces alone", priors={"GLOSS_SHARE": 1e-6}),
    Variant("hidden", "a body hides none of the sky's light", priors={"HIDDEN_MEAN": 0.0, "HIDDEN_SIGMA": _NONE}),
    Variant("wings", "a Gaussian point spread", priors={"WINGS_SIGMA_PX": _NONE}),
    Variant("air", "no speckle and no image shifts", priors={"HERMITE_SIGMA": _NONE, "SHIFT_SHARE": _NONE}),
    Variant("edges", "no discrepancy of places", priors={"EDGE_PX": _NONE}),
    Variant("paint", "nothing is learnt of albedo and gloss", priors={"PAINT_DRIFT": 1e3}),
    Variant("memory", "frames err independently", priors={"MEMORY_KEPT": 1.0, "EVIDENCE_KEPT": 1.0}),
    Variant("trust", "evidence decides between modes with all its nats", priors={"EVIDENCE_TRUST": 1.0}),
    Variant("births", "no mode is born beside a track", priors={"BIRTH": 1e-12}),
    Variant("psf", "point spread fixed at 0.3 px at first", {"camera": {"psf_sigma_px": 0.3}}),
    Variant("twins", "the filter is not told of the body's symmetries", twins=False),
    Variant("velocity", "jitter instead of rates", {"motion": {"kind": "jitter"}}),
    Variant("paper", "the published method", {"filter": {"preset": "paper", "method": "bootstrap"}}),
)


@contextmanager
def altered(priors: Mapping[str, Any]) -> Iterator[None]:
    """``service.inference.model.prior`` with other values for a while. One thread of one process only."""
    before = {name: getattr(prior, name) for name in priors}
    try:
        for name, value in priors.items():
            setattr(prior, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(prior, name, value)


def choose_variants(names: Sequence[str]) -> list[Variant]:
    """The variants of these names, with the default first; all of them where none is named. Raises ``VariantError``."""
    known = [variant.name for variant in VARIANTS]
    for name in names:
        if name not in known:
            raise VariantError(f"no variant {name!r}; there are {', '.join(known)}")
    return [variant for variant in VARIANTS if not names or variant.name in (*names, "default")]


def overlay(*layers: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sections laid one over the other, later ones winning field by field."""
    merged: dict[str, dict[str, Any]] = {}
    for layer in layers:
        for section, values in layer.items():
            merged[section] = {**merged.get(section, {}), **values}
    return merged
