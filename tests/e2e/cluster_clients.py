"""Clients of a cluster that retry at either process, and what its database says of it."""

import random
import threading
import time

import httpx
import psycopg
from passes import PNG, begin, comparable, fake_pass

GIVEN = fake_pass(32)
_ANSWER_S = 3.0  # a process that was stopped never answers: ask the other
_LIMIT_S = 120.0
_TRIGGER = """
CREATE TABLE stale_writes (session_id text, idx bigint);
CREATE FUNCTION note_stale() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  IF NEW.epoch <> (SELECT epoch FROM sessions WHERE id = NEW.session_id) THEN
    INSERT INTO stale_writes VALUES (NEW.session_id, NEW.idx);
  END IF;
  RETURN NULL;
END $$;
CREATE TRIGGER note_stale AFTER INSERT ON frames FOR EACH ROW EXECUTE FUNCTION note_stale();
"""


def fake_session(url: str) -> str:
    """A session that is ready for the frames of ``GIVEN``."""
    with httpx.Client(base_url=url, timeout=60) as http:
        return begin(http, GIVEN, name="body.glb", filter={"seed": 3})


def moved(url: str, session: str) -> float:
    """Have the session moved to the other process. When that was asked for, monotonic s.

    There is none while its lease has run out; its next beat mends that, after a pause too.
    """
    until = time.monotonic() + _LIMIT_S
    while True:
        moment = time.monotonic()
        answer = httpx.post(f"{url}/v1/sessions/{session}/move", timeout=60)
        if answer.status_code != httpx.codes.CONFLICT or moment > until:
            answer.raise_for_status()
            return moment


class Client:
    """Posts one session's frames in order, each to either process and, where that does not answer, to the other."""

    def __init__(self, urls: list[str], session: str, seed: int) -> None:
        self.session = session
        self.answers: list[dict] = []
        self._urls = urls
        self._dice = random.Random(seed)
        self._times: list[tuple[float, float]] = []  # of each frame: first sent, answered
        self._changed = threading.Condition()
        self._stopping = False
        self._error: Exception | None = None
        self._http = httpx.Client(timeout=_ANSWER_S)
        self._thread = threading.Thread(target=self._run)

    def start(self) -> None:
        """Post from now on, in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Post no more; raises what went wrong."""
        self.leave()
        if self._error is not None:
            raise self._error

    def leave(self) -> None:
        """End the thread."""
        self._stopping = True
        if self._thread.is_alive():
            self._thread.join()
        self._http.close()

    def post(self, count: int) -> None:
        """So many frames more."""
        for _ in range(count):
            n, started = len(self.answers), time.monotonic()
            answer = self._answer(n)
            with self._changed:
                self.answers.append(comparable(answer))
                self._times.append((started, time.monotonic()))
                self._changed.notify_all()

    def answered_after(self, moment: float) -> float:
        """When the first frame was answered after the moment; waits for it."""
        with self._changed:
            while not self._times or self._times[-1][1] <= moment:
                if self._error is not None or not self._changed.wait(_LIMIT_S):
                    raise AssertionError(f"no answer since {moment}") from self._error
            return next(answered for _, answered in self._times if answered > moment)

    def latencies(self, since: float) -> list[float]:
        """Of the frames answered since."""
        with self._changed:
            return [answered - started for started, answered in self._times[-1000:] if answered > since]

    def _run(self) -> None:
        try:
            while not self._stopping:
                self.post(1)
        except Exception as error:  # noqa: BLE001 -- raised in the main thread by stop()
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _answer(self, n: int) -> dict:
        until = time.monotonic() + _LIMIT_S
        turn = self._dice.randrange(len(self._urls))
        while time.monotonic() < until:
            url = f"{self._urls[turn % len(self._urls)]}/v1/sessions/{self.session}/frames/{n}"
            try:
                answer = self._http.put(url, content=GIVEN.frames[n % len(GIVEN.frames)], headers=PNG)
            except httpx.TransportError:
                turn += 1
                continue
            if answer.status_code == 200:
                return answer.json()
            if answer.status_code not in (429, 503):
                raise AssertionError(answer.text)
            time.sleep(0.02)
        raise AssertionError("no answer in two minutes")


class Database:
    """Asked directly, past the service."""

    def __init__(self, url: str) -> None:
        self._url = url.replace("+psycopg", "")

    def watch_writes(self) -> None:
        """Note from now on every frame that is written under another epoch than its session's."""
        with psycopg.connect(self._url, autocommit=True) as connection:
            connection.execute(_TRIGGER)

    def stale_writes(self) -> int:
        """How many there were."""
        return self._one("SELECT count(*) FROM stale_writes") or 0

    def owner_url(self, session: str) -> str | None:
        """Address of the process that has the session."""
        return self._one("SELECT url FROM instances JOIN owners ON instance = id WHERE session_id = %s", session)

    def bodies(self, session: str) -> list[bytes]:
        """The files of a session's frames, in their order."""
        query = "SELECT body FROM frame_bodies WHERE session_id = %s ORDER BY idx"
        return [row[0] for row in self._all(query, session)]

    def _one(self, query: str, *values: object):
        return next((row[0] for row in self._all(query, *values)), None)

    def _all(self, query: str, *values: object) -> list[tuple]:
        while True:
            try:
                with psycopg.connect(self._url) as connection:
                    return connection.execute(query, values).fetchall()
            except psycopg.OperationalError:  # it is being restarted
                time.sleep(0.05)
