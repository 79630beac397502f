"""Forged checkpoints through the application with the real tracker, in this process; what is taken in is then used."""

import random
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import trimesh

sys.path += [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[1] / "e2e")]
from api_client import running
from passes import PNG, box_pass

from service.main import create_app
from service.settings import Settings
from service.workers.base import ModelJob, ModelReport
from service.workers.inline import InlineTransport
from service.workers.tracker import Tracker
from tests.fuzz.attack import ASKED
from tests.fuzz.mutate import forge

CONFIG = {"filter": {"particles": 60}}
GIVEN = box_pass(5, size=32)
CUBE = trimesh.creation.box((1.0, 1.0, 1.0)).export(file_type="stl")
EXPORTS = ("aem", "acm", "apm", "stk", "czml", "csv", "npz")


@dataclass
class Findings:
    """What came of the blobs."""

    inputs: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    taken: int = 0
    wrong: list[str] = field(default_factory=list)


class Remembering(Tracker):
    """Prepares each model once: it is not the model that is tried here."""

    known: dict[tuple[bytes, str, str], ModelReport]

    def prepare_model(self, job: ModelJob) -> ModelReport:
        self.known = getattr(self, "known", {})
        key = (job.data, job.file_type, repr(job.joints))
        if key not in self.known:
            self.known[key] = super().prepare_model(job)
        return self.known[key]


async def run(count: int, seed: int) -> Findings:
    """``count`` forgeries of checkpoints with and without border background, and of two models."""
    found = Findings()
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), log_level="error")
        async with running(create_app(settings, InlineTransport(Remembering))) as api:
            blobs = [await _good(api.http, query, many) for query, many in (("", 1), ("?border=4", 1), ("", 2))]
            for number in range(count):
                dice = random.Random(seed << 32 | number)
                await _try(api.http, forge(dice, blobs[number % 3]), f"forged-{number}", found)
    return found


async def _good(http: httpx.AsyncClient, query: str, many: int) -> bytes:
    files = [("box.stl", GIVEN.mesh), ("cube.stl", CUBE)][:many]
    models = [(await http.post("/v1/models", files={"file": one})).raise_for_status().json() for one in files]
    ids = [model["model_id"] for model in models]
    chosen = {"model_id": ids[0]} if many == 1 else {"model_ids": ids}
    session = (await http.post("/v1/sessions", json={**chosen, **CONFIG})).raise_for_status()
    here = f"/v1/sessions/{session.json()['session_id']}"
    for image in GIVEN.background:
        (await http.post(f"{here}/background{query}", content=image, headers=PNG)).raise_for_status()
    for n, image in enumerate(GIVEN.frames[:3]):
        headers = {**PNG, "Idempotency-Key": str(n)}
        query = f"?time=2026-11-20T03:04:0{n}Z&ra_deg=10&dec_deg=20&position_angle_deg=3"
        (await http.post(f"{here}/frames{query}", content=image, headers=headers)).raise_for_status()
    return (await http.get(f"{here}/checkpoint")).raise_for_status().content


async def _try(http: httpx.AsyncClient, blob: bytes, name: str, found: Findings) -> None:
    here = f"/v1/sessions/{name}"
    found.inputs += 1
    answers = [await http.put(f"{here}/checkpoint", content=blob)]
    if answers[0].status_code in (200, 201):
        found.taken += 1
        paths = ["", "/estimates", "/estimates/0/overlay.png", "/checkpoint", *ASKED]
        paths += [f"/export?format={form}" for form in EXPORTS]
        answers += [await http.get(here + path) for path in paths]
        for kind in ("application/json", "application/x-npz"):
            answers.append(await http.get(f"{here}/particles", headers={"Accept": kind}))
        for image in GIVEN.frames[3:]:
            answers.append(await http.post(f"{here}/frames", content=image, headers=PNG))
        (await http.delete(here)).raise_for_status()
    for answer in answers:
        found.statuses[answer.status_code] += 1
        if answer.status_code >= 500:
            url = answer.request.url.path
            found.wrong.append(f"{name}: {answer.request.method} {url}: {answer.status_code} {answer.text[:200]}")
