"""Clients that share a session: they post frames at the same indices, under keys, read, retry or give up, and note it.

What was asked and told goes into a history (``histories``). A call that was given up may still be done at any time; one
that is retried is one call, since index and key let none of its tries be applied twice.
"""

import hashlib
import random
import threading
import time
import uuid
from collections import Counter
from typing import Any

import httpx
from cluster_clients import GIVEN
from histories import History, digest
from passes import PNG

ANSWER_S = 3.0
_RETRIED_S = 25.0
_LATER = (429, 503)


class Sharing:
    """One client of a session that others post to as well. ``urls`` are of all processes."""

    def __init__(self, urls: list[str], session: str, number: int, history: History, seed: int) -> None:
        self.session = session
        self.unforeseen: Counter[str] = Counter()
        self.tries: Counter[str] = Counter()
        self.frames = 0
        self.stored_at = 0.0  # when its last frame was acknowledged, monotonic
        self._urls, self._number, self._history = urls, number, history
        self._dice = random.Random(seed)
        self._next = 0  # what it takes for the next index
        self._keys: list[str] = []
        self._stopping = threading.Event()
        self._http = httpx.Client(timeout=ANSWER_S)
        self._thread = threading.Thread(target=self._run)

    def start(self) -> None:
        """Call from now on, in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Begin no more calls; those under way end."""
        self._stopping.set()

    def join(self) -> None:
        """Wait for the last of them."""
        self._thread.join()

    def look(self) -> None:
        """Count, and read every frame there is, at every process."""
        for url in self._urls:
            self._count(url)
            for index in range(self._next + 1):
                self._get(index, url)

    def _run(self) -> None:
        calls = (self._put, self._put_again, self._post, self._get, self._by_key, self._count)
        while not self._stopping.is_set():
            self._dice.choices(calls, (40, 8, 14, 25, 5, 8))[0]()
            self._stopping.wait(self._dice.uniform(0, 0.05))

    def _put(self) -> None:
        self._store("put", self._next, self._dice.randrange(len(GIVEN.frames)))

    def _put_again(self) -> None:
        """An index that is taken, or one that is not yet to be had."""
        self._store("put", self._dice.randrange(self._next + 2), self._dice.randrange(len(GIVEN.frames)))

    def _post(self) -> None:
        self._keys.append(uuid.uuid4().hex)
        self._store("post", -1, self._dice.randrange(len(GIVEN.frames)), self._keys[-1])

    def _get(self, index: int | None = None, url: str | None = None) -> None:
        given = self._dice.randrange(self._next + 2) if index is None else index
        self._read("get", f"estimates/{given}", {"index": given}, url)

    def _by_key(self) -> None:
        if self._keys:
            key = self._dice.choice(self._keys)
            self._read("by-key", f"frames/by-key/{key}", {"key": key})

    def _count(self, url: str | None = None) -> None:
        begin = time.monotonic_ns()
        answer = self._try("GET", url or self._dice.choice(self._urls), "")
        if answer is not None and answer.status_code == httpx.codes.OK:
            self._note("count", begin, "counted", at=answer.json()["frames"])
        elif answer is not None and answer.status_code not in _LATER:
            self._wonder("count", answer)

    def _read(self, kind: str, path: str, what: dict[str, Any], url: str | None = None) -> None:
        """Once; what was not answered says nothing."""
        begin = time.monotonic_ns()
        answer = self._try("GET", url or self._dice.choice(self._urls), f"/{path}")
        if answer is None or answer.status_code in (202, *_LATER):
            return
        if answer.status_code == httpx.codes.OK:
            self._saw(answer.json())
            told = {"at": answer.json()["index"], "answer": digest(answer.json())}
            self._note(kind, begin, "stored", **what, **told)
        elif answer.status_code == httpx.codes.NOT_FOUND:
            self._note(kind, begin, "absent", **what)
        else:
            self._wonder(kind, answer)

    def _store(self, kind: str, index: int, image: int, key: str = "") -> None:
        body, begin = GIVEN.frames[image], time.monotonic_ns()
        what = {"index": index, "key": key, "body": hashlib.sha256(body).hexdigest()}
        headers = PNG | ({"Idempotency-Key": key} if key else {})
        path, method = ("/frames", "POST") if key else (f"/frames/{index}", "PUT")
        until = time.monotonic() + (_RETRIED_S if self._dice.random() < 0.75 else 0)
        while True:
            answer = self._try(method, self._dice.choice(self._urls), path, content=body, headers=headers)
            if answer is not None and answer.status_code not in _LATER:
                return self._stored(kind, begin, what, answer)
            if time.monotonic() >= until:
                return self._note(kind, begin, "unknown", **what)
            self._stopping.wait(0.02)

    def _stored(self, kind: str, begin: int, what: dict[str, Any], answer: httpx.Response) -> None:
        """What a try was told at last. One that came too early may have another try that comes later: still unknown."""
        told = answer.json()
        if answer.status_code == httpx.codes.OK:
            self._saw(told)
            self.stored_at = time.monotonic()
            self.frames += not told["duplicate"]
            found = {"at": told["index"], "answer": digest(told), "repeats": told["duplicate"]}
            self._note(kind, begin, "stored", **what, **found)
        elif told.get("type", "").endswith("frame-conflict"):
            self._next = max(self._next, what["index"] + 1)
            self._note(kind, begin, "conflict", **what, answer=told["sha256"])
        elif told.get("type", "").endswith("frame-gap"):
            self._note("count", begin, "counted", at=told["expected"])
            self._note(kind, begin, "unknown", **what)
        else:
            self._wonder(kind, answer)
            self._note(kind, begin, "unknown", **what)

    def _saw(self, estimate: dict[str, Any]) -> None:
        self._next = max(self._next, estimate["index"] + 1)

    def _try(self, method: str, url: str, path: str, **more: Any) -> httpx.Response | None:
        try:
            answer = self._http.request(method, f"{url}/v1/sessions/{self.session}{path}", **more)
        except httpx.HTTPError as error:
            self.tries[type(error).__name__] += 1
            return None
        self.tries[str(answer.status_code)] += 1
        return answer

    def _note(self, kind: str, begin: int, result: str, **more: Any) -> None:
        self._history.add(session=self.session, client=self._number, kind=kind, begin=begin, result=result, **more)

    def _wonder(self, kind: str, answer: httpx.Response) -> None:
        self.unforeseen[f"{kind}: {answer.status_code} {answer.text[:300]}"] += 1
