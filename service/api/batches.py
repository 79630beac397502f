"""The answer to a body of several frames: newline-delimited JSON, one estimate per line as soon as it is stored."""

from __future__ import annotations

from collections.abc import AsyncIterator

import structlog
from starlette.responses import StreamingResponse

from service.access.principal import Principal, SessionKey
from service.api.problems import NDJSON, problem_line
from service.api.services import Services
from service.errors import InputError, SkyposeError
from service.sessions.frame import Answer, FrameIn

log = structlog.get_logger(__name__)


async def stream_batch(
    services: Services, session: SessionKey, caller: Principal, whole: FrameIn, in_background: bool
) -> StreamingResponse:
    """Raises what the first frame is refused for; a later refusal is the last line, as a problem document."""
    if in_background:
        raise InputError("a file of several frames is answered as it is tracked", field="header:Prefer")
    answers = _charged(services, session, caller, services.batches.track(session, whole))
    first = await anext(answers)
    return StreamingResponse(_lines(first, answers), media_type=NDJSON)


async def _charged(
    services: Services, session: SessionKey, caller: Principal, answers: AsyncIterator[Answer]
) -> AsyncIterator[Answer]:
    """Every frame counts as one sent singly; a debt is for the next call to wait for. Raises ``BusyError``."""
    with services.batch_places.take():  # all its frames are in memory, decoded, until the last is tracked
        async for answer in answers:
            owner = await services.registry.get(session)
            services.limits.take(caller, "pixels", owner.frame_pixels)
            yield answer


async def _lines(first: Answer, answers: AsyncIterator[Answer]) -> AsyncIterator[bytes]:
    yield first.document + b"\n"
    try:
        async for answer in answers:
            yield answer.document + b"\n"
    except SkyposeError as error:
        log.info("batch ended", problem=error.slug)
        yield problem_line(error)
