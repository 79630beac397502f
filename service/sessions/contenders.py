"""Which spacecraft is this: every frame tracked under each model, and what the evidence says of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import orjson

from service.inference.articulation import Articulation
from service.inference.params import SessionConfig
from service.inference.symmetry import Symmetry
from service.inference.weights import normalise
from service.sessions.document import JointNames
from service.sessions.library import articulation_of, twins_of
from service.store.base import ModelRecord, StoredContender
from service.store.scope import public_id
from service.workers.base import PackedFrameReport


@dataclass(frozen=True)
class Contender:
    """One model that the object may be, with its own posterior. A plain session has one."""

    model: ModelRecord
    articulation: Articulation
    twins: tuple[Symmetry, ...]
    names: JointNames
    state: bytes | None
    log_evidence: float = 0.0  # of all frames so far

    @classmethod
    def of(cls, model: ModelRecord, config: SessionConfig, state: bytes | None, log_evidence: float = 0.0) -> Contender:
        """A model under a session's configuration."""
        articulation = articulation_of(model)
        return cls(model, articulation, twins_of(model), JointNames.of(articulation, config), state, log_evidence)

    def after(self, report: PackedFrameReport) -> Contender:
        """The same after one more frame."""
        return replace(self, state=report.state, log_evidence=self.log_evidence + report.estimate.log_evidence)


def leader(contenders: Sequence[Contender]) -> int:
    """The most probable one, the first of equals."""
    return int(np.argmax([contender.log_evidence for contender in contenders]))


def ranking(contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """``models`` of an estimate, most probable first: Bayes' rule over the frames so far, all equally likely before."""
    log_evidence = np.array([contender.log_evidence for contender in contenders])
    probability = np.exp(normalise(log_evidence)[0])
    return [
        {
            "model_id": public_id(contenders[k].model.id),
            "probability": float(probability[k]),
            "log_evidence": float(log_evidence[k]),
        }
        for k in np.argsort(-log_evidence, kind="stable")
    ]


def stored(contenders: Sequence[Contender]) -> tuple[StoredContender, ...]:
    """As the store keeps them; nothing for a plain session, whose state is with its particles."""
    if len(contenders) == 1:
        return ()
    return tuple(StoredContender(c.model.id, c.state, c.log_evidence) for c in contenders)


def model_of(estimate: Mapping[str, Any]) -> str | None:
    """The model that an estimate was made with; None in a session that has one."""
    ranked = estimate.get("models")
    return str(ranked[0]["model_id"]) if ranked else None


def of_the_leader(estimates: Sequence[bytes]) -> list[bytes]:
    """Those of the estimates, as JSON, that were made with the model of the last."""
    models = [model_of(orjson.loads(estimate)) for estimate in estimates]
    return [estimate for estimate, model in zip(estimates, models, strict=True) if model == models[-1]]
