"""What a session's frames will need, prepared while its empty frames come."""

from __future__ import annotations

import structlog

from service.errors import SkyposeError
from service.inference.params import SessionConfig
from service.sessions.contenders import Contender
from service.sessions.lighting import light_at
from service.store.scope import SessionKey
from service.workers.base import ReadyJob
from service.workers.engine import BlobSource, Engine

log = structlog.get_logger(__name__)


async def prepare(
    engine: Engine, session: SessionKey, config: SessionConfig, contenders: tuple[Contender, ...], blobs: BlobSource
) -> None:
    """Have the session's worker prepare each body, with its templates where the session is told the Sun."""
    light = light_at(config, {}).light
    for one in contenders:
        job = ReadyJob(config, one.model.blob_key, one.model.file_type, one.articulation, light)
        try:
            await engine.ready(session, job, blobs)
        except SkyposeError as error:  # a frame will meet it, and tell it
            log.info("not prepared", error=error.detail)
