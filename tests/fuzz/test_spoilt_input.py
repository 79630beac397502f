"""The short form of the fuzzer: the same inputs every time. ``python -m tests.fuzz.campaign`` is the long one."""

import dataclasses
import json
import typing

import pytest

from service.api.schemas import SessionRequest
from service.inference.params import SessionConfig
from service.main import create_app
from service.settings import Settings
from service.workers.inline import InlineTransport
from tests.fuzz import direct, fields, forged, schema
from tests.fuzz.fields import CUBE, FakeWorker, running
from tests.fuzz.seeds import json_seeds

DECODE_LIMIT_MB = 2048


def test_spoilt_files_are_refused_or_decoded():
    found = direct.run(1500, seed=1)
    assert found.inputs == 1500
    assert not found.wrong
    assert not found.tripped
    assert found.answers["decoded"] < 750
    assert found.peak_mb < DECODE_LIMIT_MB


def _fields(config: type) -> set[str]:
    return {one.name for one in dataclasses.fields(config)}


def test_every_field_of_a_session_is_among_those_that_are_spoilt():
    bodies = [json.loads(seed) for seed in json_seeds()]
    assert set().union(*bodies) == set(SessionRequest.model_fields)
    for section, config in typing.get_type_hints(SessionConfig).items():
        if dataclasses.is_dataclass(config):
            assert set().union(*(body.get(section, {}) for body in bodies)) == _fields(config), section


@pytest.mark.anyio
async def test_what_is_spoilt_is_good_before(tmp_path):
    app = create_app(Settings(data_dir=tmp_path, log_level="error"), InlineTransport(FakeWorker))
    async with running(app) as api:
        models = [(await api.model(CUBE + body)).json()["model_id"] for body in (b"joint", b"another")]
        for seed in json_seeds(*models, ("panel",)):
            answer = await api.http.post("/v1/sessions", json=json.loads(seed))
            assert answer.status_code == 201, (seed, answer.text)


@pytest.mark.anyio
async def test_spoilt_fields_are_refused_or_taken():
    found = await fields.run(400, seed=3)
    assert found.inputs >= 400
    assert not found.wrong
    assert found.statuses["422"] > 50
    assert found.statuses["201"] > 10
    assert found.statuses["read"] > 3


@pytest.mark.anyio
async def test_forged_checkpoints_are_refused_or_harmless():
    found = await forged.run(30, seed=2)
    assert found.inputs == 30
    assert not found.wrong
    assert found.statuses[422] > 10


@pytest.mark.timeout(600)
def test_the_api_is_as_its_document_says_for_good_and_bad_values():
    ended = schema.run(1, seed=1, phases="examples,coverage", worker="fake_worker:FakeWorker")
    assert ended.status == 0, ended.text[-6000:]
    assert ended.cases > 500
