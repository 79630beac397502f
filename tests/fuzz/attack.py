"""Spoilt requests to a real server with the real tracker: no answer of 500 or more, refusals as problem documents."""

import json
import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx

from tests.fuzz.mutate import forge, mend_glb, mend_urdf, spoil, spoil_json
from tests.fuzz.seeds import Seed, encoded, grey, image_seeds, json_seeds, mesh_seeds, video_seeds

SMALL = {"filter": {"particles": 60}}
PNG = {"Content-Type": "image/png"}
SCRATCH_FOR = 200  # attacks until the session that takes spoilt images is a new one
TOLD = (
    *("time=2026-11-20T03:04:05Z", "time=9999-12-31T23:59:59-23:59", "time=1e30", "sun=0.1,0.2,-0.9", "sun=0,0,0"),
    *("ra_deg=10&dec_deg=20", "position_angle_deg=3", "az_deg=120&el_deg=45", "el_deg=91", "sun=1e308,1e308,1e308"),
)
EXPORTS = ("aem", "acm", "apm", "stk", "czml", "csv", "npz")
ASKED = (
    *("/motion", "/report", "/estimates?smoothed=true", "/export?format=czml&model=true", "/estimates/0/frame.png"),
    *("/export?format=acm&smoothed=true&pose=best", "/estimates/0/model.png", "/estimates/0/residual.png"),
)
OBJECT = {"name": "an object", "sessions": ["SESSION"]}


@dataclass
class Outcome:
    """What came of the requests."""

    requests: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)  # there must be none


class Attacker:
    """A client that sends what it should not. ``http`` points to the server."""

    def __init__(self, http: httpx.Client, seed: int) -> None:
        self.http = http
        self.outcome = Outcome()
        self._seed = seed
        self._images = [*image_seeds(), *video_seeds()]
        self._meshes = mesh_seeds()
        self._models = [self._upload(next(s for s in self._meshes if s.kind == kind)) for kind in ("glb", "stl")]
        self.session, self._scratch = self._begin(), self._begin()
        self._checkpoint = http.get(f"/v1/sessions/{self.session}/checkpoint").raise_for_status().content
        self._attacks: tuple[Callable[[random.Random], None], ...] = (
            *(self.image, self.image, self.image, self.mesh, self.json_body, self.json_body),
            *(self.query, self.query, self.joints, self.image, self.json_body, self.query, self.checkpoint),
        )

    def run(self, count: int, first: int = 0) -> Outcome:
        """``count`` attacks, and that the session has suffered nothing from them."""
        before = self._look()
        for number in range(first, first + count):
            dice = random.Random(self._seed << 32 | number)
            self._attacks[number % len(self._attacks)](dice)
            if number % SCRATCH_FOR == 0:
                if self._look() != before:
                    self.outcome.wrong.append(f"attack {number}: the session is another")
                self._delete(self._scratch)
                self._scratch = self._begin()
        if self._look() != before:
            self.outcome.wrong.append("the session is another")
        answer = self._post_good(self.session)
        if answer.status_code != 200:
            self.outcome.wrong.append(f"a good frame afterwards: {answer.status_code} {answer.text[:300]}")
        return self.outcome

    def image(self, dice: random.Random) -> None:
        """A spoilt file as a frame or as background, sometimes under another media type."""
        chosen = dice.choice(self._images)
        body = spoil(dice, chosen.body, dice.choice(self._images).body)
        others = [*(other.kind for other in self._images), "", "x/y", "video/x"]
        kind = chosen.kind if dice.random() < 0.9 else dice.choice(others)
        # To a session of its own: some spoilt files are still images, and those are tracked.
        ways = (
            ("POST", "frames"),
            ("POST", "frames"),
            ("PUT", "frames/0"),
            ("PUT", "frames/1"),
            ("POST", "background"),
        )
        verb, where = dice.choice(ways)
        self._call(verb, f"/v1/sessions/{self._scratch}/{where}", content=body, headers={"Content-Type": kind})

    def mesh(self, dice: random.Random) -> None:
        """A spoilt mesh."""
        chosen = dice.choice(self._meshes)
        if chosen.kind == "glb" and dice.random() < 0.5:
            body = mend_glb(dice, chosen.body)
        elif chosen.kind == "urdf" and dice.random() < 0.5:
            body = mend_urdf(dice, chosen.body)
        else:
            body = spoil(dice, chosen.body, dice.choice(self._meshes).body)
        self._call("POST", "/v1/models", files={"file": (f"x.{chosen.kind}", body)})

    def joints(self, dice: random.Random) -> None:
        """A good mesh with spoilt joints."""
        joint = {"name": "a", "kind": "revolute", "parts": ["panel"], "axis": [0, 0, 1], "origin": [0, 0, 0]}
        given = spoil_json(dice, [{**joint, "min": -90, "max": 90}])
        form = {"joints": _json(given), "name": "x"}
        glb = next(s for s in self._meshes if s.kind == "glb")
        self._call("POST", "/v1/models", files={"file": ("x.glb", glb.body)}, data=form)

    def json_body(self, dice: random.Random) -> None:
        """A spoilt configuration."""
        text = dice.choice(json_seeds(*self._models))
        body = _json(spoil_json(dice, json.loads(text))).encode() if dice.random() < 0.7 else spoil(dice, text, text)
        answer = self._call("POST", "/v1/sessions", content=body, headers={"Content-Type": "application/json"})
        if answer is not None and answer.status_code == 201:
            session = answer.json()["session_id"]
            self._call("POST", f"/v1/sessions/{session}/background", content=_frame(1), headers=PNG)
            told = "&".join(dice.sample(TOLD, dice.randrange(4)))
            self._call("POST", f"/v1/sessions/{session}/frames?{told}", content=_frame(2), headers=PNG)
            self._call("GET", f"/v1/sessions/{session}/export?format={dice.choice(EXPORTS)}")
            self._call("GET", f"/v1/sessions/{session}{dice.choice(ASKED)}")
            if dice.random() < 0.2:
                self.object_body(dice, session)
            self._delete(session)

    def object_body(self, dice: random.Random, session: str) -> None:
        """A spoilt object; where it is taken, everything is asked of it, here and of the sessions it has."""
        body = _json(spoil_json(dice, {**OBJECT, "sessions": [session]}))
        answer = self._call("POST", "/v1/objects", content=body, headers={"Content-Type": "application/json"})
        if answer is None or answer.status_code != 201:
            return
        here = f"/v1/objects/{answer.json()['object_id']}"
        self._call("PUT", f"{here}/sessions/{session}")
        pass_number = dice.choice(("0", "-1", "1e9", "x", str(2**70)))
        for path in ("", "/passes", f"/motion?pass={pass_number}", "/motion", "/spin", "/report"):
            self._call("GET", here + path)
        self._call("DELETE", here)

    def checkpoint(self, dice: random.Random) -> None:
        """A forged checkpoint; where it is taken, everything is asked of its session."""
        name = f"forged-{dice.randrange(1 << 30)}"
        here = f"/v1/sessions/{name}"
        answer = self._call("PUT", f"{here}/checkpoint", content=forge(dice, self._checkpoint))
        if answer is None or answer.status_code not in (200, 201):
            return
        for path in ("", "/estimates", "/estimates/0/overlay.png", "/checkpoint", *ASKED):
            self._call("GET", here + path)
        for kind in ("application/json", "application/x-npz"):
            self._call("GET", f"{here}/particles", headers={"Accept": kind})
        for form in EXPORTS:
            self._call("GET", f"{here}/export?format={form}")
        for n in (3, 4):
            self._call("POST", f"{here}/frames", content=_frame(n), headers=PNG)
        self._delete(name)

    def query(self, dice: random.Random) -> None:
        """Spoilt addresses, queries and headers."""
        here = f"/v1/sessions/{self.session}"
        paths = (
            *(f"{here}/estimates?after=1&limit=2", f"{here}/estimates/0", f"{here}/export?format=csv&pose=best"),
            *(f"{here}/frames?time=2026-11-20T03:04:05Z&ra_deg=1&dec_deg=2", f"{here}/background?box=1,2,3,4"),
            *(f"{here}/frames?az_deg=10&el_deg=40&sun=1,2,3", f"{here}/background?border=4"),
            *(f"{here}/export?format=aem&object_id=1998-067A", f"{here}/particles?index=0&most=9"),
            *("/v1/models?limit=3&after=0", "/v1/sessions?limit=3", f"{here}/frames/by-key/x", "/v1/system"),
            *("/v1/audit?after=1&limit=9", f"{here}/motion", f"{here}/report", "/v1/objects?limit=2&after=0"),
            f"{here}/export?format=czml&model=true&smoothed=true",
        )
        path = spoil(dice, dice.choice(paths).encode(), b"?&=%/..").decode("latin-1")
        path = "/" + "".join(c if c.isascii() and c.isprintable() and c not in " #" else f"%{ord(c):02X}" for c in path)
        headers = {"Content-Type": "image/png", "Idempotency-Key": dice.choice(("a", "k" * 300, "x y", "~"))}
        verb = dice.choice(("GET", "GET", "HEAD", "OPTIONS", "PATCH", "DELETE" if "models" in path else "GET"))
        self._call(verb, path[:4000], headers=headers if dice.random() < 0.5 else None)

    def _call(self, verb: str, path: str, **arguments: Any) -> httpx.Response | None:
        self.outcome.requests += 1
        try:
            answer = self.http.request(verb, path, **arguments)
        except (httpx.InvalidURL, UnicodeError, ValueError):
            return None  # the client library itself refuses
        self.outcome.statuses[answer.status_code] += 1
        refused = answer.status_code >= 400 and verb != "HEAD"
        if answer.status_code >= 500 or (refused and not _is_problem(answer)):
            self.outcome.wrong.append(f"{verb} {path[:100]}: {answer.status_code} {answer.text[:300]}")
        return answer

    def _look(self) -> Mapping[str, Any]:
        here = f"/v1/sessions/{self.session}"
        return {"session": self.http.get(here).json(), "estimates": self.http.get(f"{here}/estimates").json()}

    def _upload(self, seed: Seed) -> str:
        answer = self.http.post("/v1/models", files={"file": (f"x.{seed.kind}", seed.body)})
        return str(answer.raise_for_status().json()["model_id"])

    def _begin(self) -> str:
        body = {"model_id": self._models[0], **SMALL}
        session = str(self.http.post("/v1/sessions", json=body).raise_for_status().json()["session_id"])
        self.http.post(f"/v1/sessions/{session}/background", content=_frame(0), headers=PNG).raise_for_status()
        self._post_good(session).raise_for_status()
        return session

    def _post_good(self, session: str) -> httpx.Response:
        return self.http.post(f"/v1/sessions/{session}/frames", content=_frame(9), headers=PNG)

    def _delete(self, session: str) -> None:
        self.http.delete(f"/v1/sessions/{session}").raise_for_status()


def _frame(n: int) -> bytes:
    image = grey()[0].copy()
    if n:
        image[8 : 14 + n % 3, 10:20] = 200
    return encoded(".png", image)


def _json(value: Any) -> str:
    return json.dumps(value)


def _is_problem(answer: httpx.Response) -> bool:
    if answer.headers.get("content-type") != "application/problem+json":
        return False
    body = answer.json()
    return {"type", "title", "status", "detail"} <= body.keys() and body["status"] == answer.status_code
