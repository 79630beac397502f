"""Each choice of the default preset switched off, one at a time, as far as a session's parameters can."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


class VariantError(ValueError):
    """There is no variant of that name."""


@dataclass(frozen=True)
class Variant:
    """A change of the default session. ``sections`` are laid over it; ``twins`` False hides the symmetries."""

    name: str
    says: str
    sections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    twins: bool = True


BY_OUTLINE: Mapping[str, Mapping[str, Any]] = {"filter": {"method": "importance"}}
"""What is ablated: the outline's filter."""

VARIANTS = (
    Variant("default", "nothing switched off"),
    Variant("psf", "point spread fixed at 0.3 px instead of estimated", {"camera": {"psf_sigma_px": 0.3}}),
    Variant("contrast", "the paper's histogram map (Eq. 3)", {"likelihood": {"kind": "histogram"}}),
    Variant(
        "shadow",
        "unlit parts cost as much as uncovered light",
        {"likelihood": {"covered_empty_nats": 3.0, "uncovered_bright_nats": 3.0}},
    ),
    Variant("price", "unlit parts cost twice as much", {"likelihood": {"covered_empty_nats": 1.0}}),
    Variant("edge", "light costs as much at its edge as inside", {"likelihood": {"edge_nats_per_px": 1e9}}),
    Variant(
        "shading",
        "outlines alone, no light and shade inside of them",
        {"likelihood": {"shading_nats": 0.0, "shading_power": 0.0}},
    ),
    Variant("alignment", "light and shade choose between basins, refine none", {"likelihood": {"shading_power": 0.0}}),
    Variant("exponent", "every pixel independent: exponent 1", {"likelihood": {"exponent": 1.0, "misfit_nats": 1e9}}),
    Variant("misfit", "one exponent whatever the fit: 0.027", {"likelihood": {"exponent": 0.027, "misfit_nats": 1e9}}),
    Variant(
        "modes", "one frame decides between far modes by more: power 0.13", {"likelihood": {"mode_exponent": 0.13}}
    ),
    Variant("twins", "the filter is not told of the body's symmetries", twins=False),
    Variant("velocity", "jitter instead of constant velocity", {"motion": {"kind": "jitter"}}),
    Variant(
        "tempering",
        "resample, jitter, weigh (the paper's update) with the default map",
        {"filter": {"method": "bootstrap"}, "motion": {"kind": "jitter", "rotation_deg": 6.0, "log_scale": 0.03}},
    ),
    Variant("starts", "a tenth of the starts when nothing is known", {"filter": {"acquisition_particles": 600}}),
    Variant("particles", "a quarter of the particles", {"filter": {"particles": 250}}),
    Variant("adaptive", "1,000 particles in every frame", {"filter": {"adaptive": "off"}}),
    Variant("kld", "while tracking, as many particles as KLD-sampling asks for", {"filter": {"adaptive": "kld"}}),
    Variant("resampler", "multinomial instead of systematic", {"filter": {"resampler": "multinomial"}}),
    Variant("paper", "the published method", {"filter": {"preset": "paper", "method": "bootstrap"}}),
)


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
