"""The models of a session that compares several, in its checkpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import orjson
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from service.errors import CheckpointError
from service.sessions.library import Upload
from service.store.base import ModelRecord, StoredContender
from service.store.checkpoints import ComparedModel, StoredSession
from service.store.scope import public_id

MOST = 16
Bytes = NDArray[np.uint8]
_EXACTLY = ConfigDict(extra="forbid", strict=True)


class ModelRow(TypedDict):
    """What was uploaded, beside its file."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    name: Annotated[str, Field(max_length=1000)]
    file_type: Annotated[str, Field(max_length=16)]
    joints: list[dict[str, Any]] | None
    log_evidence: Annotated[float, Field(allow_inf_nan=False)]


_ROWS: TypeAdapter[list[ModelRow]] = TypeAdapter(Annotated[list[ModelRow], Field(min_length=2, max_length=MOST)])


@dataclass(frozen=True)
class Compared:
    """The models in the session's order: rows as JSON, and by number their files and posteriors."""

    rows: Bytes
    files: Mapping[str, Bytes]
    states: Mapping[str, Bytes]  # none before the first frame


def pack_models(stored: StoredSession) -> Compared | None:
    """The models of a stored session; None where it has one."""
    if not stored.compared:
        return None
    rows = [{**model_row(one.model), "log_evidence": one.contender.log_evidence} for one in stored.compared]
    states = {str(n): one.contender.state for n, one in enumerate(stored.compared)}
    return Compared(
        rows=_array(orjson.dumps(rows)),
        files={str(n): _array(one.file) for n, one in enumerate(stored.compared)},
        states={number: _array(state) for number, state in states.items() if state is not None},
    )


def model_row(model: ModelRecord) -> dict[str, Any]:
    """What is needed to prepare a model again, beside its file."""
    return {"name": model.name, "file_type": model.file_type, "joints": model.joints}


def uploads_of(compared: Compared) -> list[Upload]:
    """The models, to be prepared as if they were uploaded. Raises ``CheckpointError``."""
    try:
        rows = _ROWS.validate_python(orjson.loads(compared.rows.tobytes()))
        return [
            Upload(
                data=compared.files[str(n)].tobytes(),
                file_type=row["file_type"],
                name=row["name"][:200],
                joints=None if row["joints"] is None else tuple(row["joints"]),
            )
            for n, row in enumerate(rows)
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"the models do not fit: {error}", field="body") from error


def unpack_models(compared: Compared, models: Sequence[ModelRecord]) -> tuple[ComparedModel, ...]:
    """The models with their posteriors; ``models`` are what ``uploads_of`` gave, prepared. Raises ``ValueError``."""
    rows = _ROWS.validate_python(orjson.loads(compared.rows.tobytes()))
    if len({model.id for model in models}) < len(models):
        raise ValueError("a model is there twice")
    if set(compared.files) != {str(n) for n in range(len(rows))} or not set(compared.states) <= set(compared.files):
        raise ValueError("files or particles of no model")
    found = []
    for n, (row, model) in enumerate(zip(rows, models, strict=True)):
        state = compared.states.get(str(n))
        contender = StoredContender(model.id, None if state is None else state.tobytes(), row["log_evidence"])
        found.append(ComparedModel(model, compared.files[str(n)].tobytes(), contender))
    return tuple(found)


def check_ranking(compared: Sequence[ComparedModel], newest: Mapping[str, Any] | None, state: bytes | None) -> None:
    """The newest estimate ranks the models by the evidence they have; its particles are those of the first.

    Raises ``ValueError``.
    """
    if newest is None:
        if any(one.contender.state is not None or one.contender.log_evidence for one in compared):
            raise ValueError("models have particles or evidence without frames")
        return
    own = {public_id(one.model.id): one.contender for one in compared}
    ranked = {entry["model_id"]: entry["log_evidence"] for entry in newest["models"]}
    if ranked != {name: contender.log_evidence for name, contender in own.items()}:
        raise ValueError("the newest estimate ranks other models, or by other evidence")
    if any(contender.state is None for contender in own.values()):
        raise ValueError("a model has no particles")
    if own[newest["models"][0]["model_id"]].state != state:
        raise ValueError("the particles are not those of the most probable model")


def _array(data: bytes) -> Bytes:
    return np.frombuffer(data, np.uint8)
