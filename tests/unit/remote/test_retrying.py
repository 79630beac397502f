"""What the clients repeat, what they do not, and what they hand on: against answers made by hand."""

from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from remote_answers import estimate

from service.client import AsyncClient, Client, RefusedError, Retries, UnexpectedError
from service.remote.media import media_type_of

pytestmark = pytest.mark.anyio
BUSY = {
    "type": "urn:skypose:problem:inbox-full",
    "title": "full",
    "status": 429,
    "detail": "16 frames wait",
    "limit": 16,
}
GAP = {"type": "urn:skypose:problem:frame-gap", "title": "gap", "status": 409, "detail": "frame 3", "field": "index"}
KEYED = "idempotency-key"
Answer = Callable[[httpx.Request], httpx.Response]


class Script:
    """Answers requests one after the other; an exception is raised instead."""

    def __init__(self, *answers: Answer | httpx.Response | Exception) -> None:
        self.answers = list(answers)
        self.requests: list[httpx.Request] = []
        self.pauses: list[float] = []

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer if isinstance(answer, httpx.Response) else answer(request)

    def client(self, **options) -> Client:
        retries = Retries(attempts=4, first_pause_s=1.0, random=lambda: 1.0 - 1e-12)
        transport = httpx.MockTransport(self)
        return Client("http://pose", transport=transport, retries=retries, sleep=self.pauses.append, **options)

    def async_client(self) -> AsyncClient:
        async def sleep(seconds: float) -> None:
            self.pauses.append(seconds)

        return AsyncClient("http://pose", transport=httpx.MockTransport(self), sleep=sleep)


def problem(document: dict, **headers: str) -> httpx.Response:
    head = {"Content-Type": "application/problem+json", **headers}
    return httpx.Response(document["status"], json=document, headers=head)


def test_a_frame_is_sent_again_with_the_same_key_until_it_is_answered():
    script = Script(
        httpx.ReadTimeout("lost"),
        problem(BUSY, **{"Retry-After": "7"}),
        httpx.Response(502, text="proxy"),
        httpx.Response(200, json=estimate(0)),
    )
    answer = script.client(api_key="secret").post_frame("s", b"png", "image/png", ra_deg=1.5, time=None)
    assert answer.index == 0 and answer.best.scale_px == 3.0
    assert script.pauses == pytest.approx([1.0, 7.0, 4.0])
    assert len({request.headers[KEYED] for request in script.requests}) == 1
    assert {str(request.url) for request in script.requests} == {"http://pose/v1/sessions/s/frames?ra_deg=1.5"}
    assert {request.headers["authorization"] for request in script.requests} == {"Bearer secret"}


def test_a_frame_put_at_its_index_needs_no_key():
    script = Script(httpx.ConnectError("down"), httpx.Response(200, json=estimate(3)))
    script.client().put_frame("s", 3, b"png", "image/png")
    assert [request.url.path for request in script.requests] == ["/v1/sessions/s/frames/3"] * 2
    assert KEYED not in script.requests[0].headers


def test_a_session_is_not_begun_twice():
    lost = Script(httpx.ReadTimeout("lost"))
    with pytest.raises(httpx.ReadTimeout):
        lost.client().create_session("m")
    never_there = Script(httpx.ConnectError("down"), problem({**BUSY, "status": 503}), problem(GAP))
    with pytest.raises(RefusedError):
        never_there.client().create_session("m", filter={"seed": 1})
    assert never_there.requests[-1].content == b'{"model_id":"m","filter":{"seed":1}}'


def test_what_stands_is_raised_at_once():
    script = Script(problem(GAP))
    with pytest.raises(RefusedError) as caught:
        script.client().put_frame("s", 5, b"png", "image/png")
    error = caught.value
    assert (error.status, error.kind, error.field, error.problem["detail"]) == (409, "frame-gap", "index", "frame 3")
    with pytest.raises(UnexpectedError, match="404"):
        Script(httpx.Response(404, text="<html>")).client().system()
    with pytest.raises(UnexpectedError, match="Estimate"):
        Script(httpx.Response(200, json={})).client().estimate("s")


def test_attempts_end():
    script = Script(*[httpx.ConnectError("down")] * 4)
    with pytest.raises(httpx.ConnectError):
        script.client().system()
    assert script.pauses == pytest.approx([1.0, 2.0, 4.0])


def test_what_is_gone_when_a_deletion_is_repeated_was_deleted():
    gone = problem({**GAP, "status": 404})
    Script(httpx.ReadError("lost"), gone).client().delete_session("s")
    with pytest.raises(RefusedError):
        Script(gone).client().delete_model("m")


def lines(*documents: dict, broken: bool = False) -> httpx.Response:
    body = b"".join(httpx.Response(200, json=document).content + b"\n" for document in documents)

    class Body(httpx.SyncByteStream, httpx.AsyncByteStream):
        def __iter__(self):
            yield body
            if broken:
                raise httpx.RemoteProtocolError("cut")

        async def __aiter__(self):
            for part in self:
                yield part

    return httpx.Response(200, stream=Body(), headers={"Content-Type": "application/x-ndjson"})


def test_a_file_is_sent_again_after_a_break_and_no_estimate_is_told_twice():
    again = [{**estimate(k), "duplicate": True} for k in range(2)]
    script = Script(lines(estimate(0), estimate(1), broken=True), lines(*again, estimate(2)))
    told = list(script.client().track_file("s", b"cube", "image/fits"))
    assert [item.index for item in told] == [0, 1, 2]
    assert script.requests[0].headers[KEYED] == script.requests[1].headers[KEYED]


async def test_the_same_with_await():
    busy = {**BUSY, "status": 503, "retry_after_s": 2}
    script = Script(lines(estimate(0), busy), lines(estimate(0), estimate(1), GAP))
    async with script.async_client() as client:
        told = client.track_file("s", b"cube", "image/fits", index=0)
        assert [(await anext(told)).index for _ in range(2)] == [0, 1]
        with pytest.raises(RefusedError, match="frame-gap"):
            await anext(told)
    assert len(script.pauses) == 1 and script.pauses[0] >= 2


def test_lists_are_read_to_their_end():
    first = {"estimates": [estimate(0)], "next": "/v1/sessions/s/estimates?after=0&limit=1&smoothed=true"}
    script = Script(httpx.Response(200, json=first), httpx.Response(200, json={"estimates": [], "next": None}))
    assert len(list(script.client().estimates("s", smoothed=True))) == 1
    assert [request.url.query for request in script.requests] == [
        b"after=-1&smoothed=true",
        b"after=0&limit=1&smoothed=true",
    ]


def sent(*events: str) -> httpx.Response:
    return httpx.Response(200, text="".join(f"event: x\ndata: {event}\n\n" for event in events))


def test_a_stream_goes_on_where_it_broke():
    session_gone = {**GAP, "status": 404, "type": "urn:skypose:problem:not-found"}
    script = Script(
        sent('{"type":"heartbeat","seq":1}'),
        problem({**BUSY, "status": 503}),
        sent('{"type":"resync-required","seq":9}', '{"type":"end","seq":9,"reason":"shutdown"}'),
        httpx.ReadTimeout("silent"),
        sent('{"type":"end","seq":9,"reason":"deleted"}'),
    )
    events = list(script.client().watch("s", after=0, over="sse"))
    assert [(event.type, event.seq) for event in events] == [("resync-required", 9), ("end", 9)]
    assert [request.url.query for request in script.requests] == [
        b"after=0",
        b"after=1",
        b"after=1",
        b"after=9",
        b"after=9",
    ]
    with pytest.raises(RefusedError, match="not-found"):
        list(Script(problem(session_gone)).client().watch("s", after=0, over="sse"))


def test_a_file_name_tells_the_media_type(tmp_path: Path):
    known = {"a.PNG": "image/png", "b.fits.gz": "image/fits", "c.ser": "video/x-ser", "d.tar.gz": None, "e.txt": None}
    assert {name: media_type_of(name) for name in known} == known
    with pytest.raises(ValueError, match="media_type"):
        Script().client().put_frame("s", 0, tmp_path / "frame.xyz")
