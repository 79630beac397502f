"""The short form of the fuzzer: the same inputs every time. ``python -m tests.fuzz.campaign`` is the long one."""

import pytest

from tests.fuzz import direct, fields, forged, schema

DECODE_LIMIT_MB = 2048


def test_spoilt_files_are_refused_or_decoded():
    found = direct.run(1500, seed=1)
    assert found.inputs == 1500
    assert not found.wrong
    assert not found.tripped
    assert found.answers["decoded"] < 750
    assert found.peak_mb < DECODE_LIMIT_MB


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
