"""Spoilt fields to the application in this process with a fake worker, and spoilt trees of models to what reads them.

Thousands in a minute: sessions' bodies with every field, what frames are told, times, cursors, joints.
"""

import json
import random
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import httpx

sys.path += [str(Path(__file__).resolve().parents[1])]
from api_client import PNG, image, running
from fake_worker import CUBE, FakeWorker

from gpu.mesh import MeshError, assemble
from gpu.mesh_file import read_parts
from gpu.mesh_limits import MeshLimits
from service.errors import InputError
from service.main import create_app
from service.models.articulations import read_joints
from service.settings import Settings
from service.workers.inline import InlineTransport
from tests.fuzz.attack import ASKED, EXPORTS, OBJECT, TOLD
from tests.fuzz.mutate import VALUES, mend_glb, mend_urdf, spoil, spoil_json
from tests.fuzz.seeds import Seed, json_seeds, mesh_seeds

JOINT = {"name": "a", "kind": "revolute", "parts": ["panel"], "axis": [0, 0, 1], "origin": [0, 0, 0], "min": -90}
TIE = {"name": "a", "tied_to": "b", "ratio": 2.0}


@dataclass
class Findings:
    """What came of the fields."""

    inputs: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)  # there must be none


async def run(count: int, seed: int) -> Findings:
    """``count`` inputs: half of them to the application, half to the readers of models."""
    found = Findings()
    for number in range(0, count, 2):
        _model(random.Random(seed << 32 | number), found)
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), log_level="error", rate_calls_per_s=0, quota_sessions=0)
        async with running(create_app(settings, InlineTransport(FakeWorker))) as api:
            models = [(await api.model(CUBE + body)).json()["model_id"] for body in (b"joint", b"another")]
            while found.inputs < count:
                await _session(random.Random(seed << 32 | 2 * found.inputs + 1), api.http, models, found)
    return found


@cache
def _trees() -> list[Seed]:
    return [seed for seed in mesh_seeds() if seed.kind in ("glb", "urdf")]


def _model(dice: random.Random, found: Findings) -> None:
    chosen = dice.choice(_trees())
    mended = mend_glb(dice, chosen.body) if chosen.kind == "glb" else mend_urdf(dice, chosen.body)
    joints = spoil_json(dice, [dict(JOINT), dict(TIE)]) if dice.random() < 0.5 else None
    given = [one for one in joints if isinstance(one, dict)] if isinstance(joints, list) else None
    found.inputs += 1
    try:
        mesh = assemble(read_parts(chosen.body if given else mended, chosen.kind))
        read_joints(chosen.body if given else mended, chosen.kind, mesh, given, MeshLimits())
        found.statuses["read"] += 1
    except (InputError, MeshError):
        found.statuses["refused"] += 1
    except Exception as error:  # noqa: BLE001 -- this is what is looked for
        found.wrong.append(f"{chosen.kind} {given}: {type(error).__name__}: {error}")


async def _session(dice: random.Random, http: httpx.AsyncClient, models: list[str], found: Findings) -> None:
    """One spoilt body of a session; where it is taken, a frame with what it is told, and an export."""
    text = dice.choice(json_seeds(*models, ("panel",)))
    good = dice.random() < 0.2
    body = text if good else json.dumps(spoil_json(dice, json.loads(text))).encode()
    if dice.random() < 0.1:
        body = spoil(dice, text, text)
    json_kind = {"Content-Type": "application/json"}
    answer = await _call(http, "POST", "/v1/sessions", found, content=body, headers=json_kind)
    if answer is None or answer.status_code != 201:
        return
    here = f"/v1/sessions/{answer.json()['session_id']}"
    await _call(http, "POST", f"{here}/background", found, content=image(), headers=PNG)
    told = dict(pair.split("=") for one in dice.sample(TOLD, dice.randrange(4)) for pair in one.split("&"))
    if told and dice.random() < 0.5:
        told[dice.choice(sorted(told))] = str(dice.choice(VALUES))[:300]
    await _call(http, "POST", f"{here}/frames", found, content=image(1), headers=PNG, params=told)
    after = str(dice.choice(VALUES))[:300]
    for path in (f"/export?format={dice.choice(EXPORTS)}", f"/estimates?smoothed=true&after={dice.choice((-1, 0))}"):
        await _call(http, "GET", here + path, found)
    await _call(http, "GET", f"{here}/estimates", found, params={"after": after})
    await _call(http, "GET", here + dice.choice(ASKED), found)
    if dice.random() < 0.2:
        await _object(dice, http, answer.json()["session_id"], found)
    (await http.delete(here)).raise_for_status()


async def _object(dice: random.Random, http: httpx.AsyncClient, session: str, found: Findings) -> None:
    """A spoilt object with that session; where it is taken, what it tells."""
    body = json.dumps(spoil_json(dice, {**OBJECT, "sessions": [session]})).encode()
    json_kind = {"Content-Type": "application/json"}
    answer = await _call(http, "POST", "/v1/objects", found, content=body, headers=json_kind)
    if answer is None or answer.status_code != 201:
        return
    here = f"/v1/objects/{answer.json()['object_id']}"
    for path in ("/passes", "/motion", "/spin", "/report"):
        await _call(http, "GET", here + path, found)
    await _call(http, "GET", f"{here}/motion", found, params={"pass": str(dice.choice(VALUES))[:300]})
    await _call(http, "DELETE", here, found)


async def _call(
    http: httpx.AsyncClient, verb: str, path: str, found: Findings, **given: object
) -> httpx.Response | None:
    found.inputs += 1
    try:
        answer = await http.request(verb, path, **given)  # type: ignore[arg-type]
    except (httpx.InvalidURL, UnicodeError, ValueError):
        return None  # the client library itself refuses
    found.statuses[str(answer.status_code)] += 1
    if answer.status_code >= 500:
        found.wrong.append(f"{verb} {path} {given}: {answer.status_code} {answer.text}"[:1200])
    return answer
