"""What a session's frames will need is prepared before they come."""

from dataclasses import replace

import pytest

import service.workers.following as following
from service.errors import MissingBlobError
from service.inference.light import Light
from service.workers.base import ReadyJob

SUN = Light(towards_sun=(0.3, -0.2, -0.93))


def ready_of(job, light):
    return ReadyJob(job.config, job.model, job.file_type, job.articulation, light, job.blobs)


def test_a_first_frame_finds_its_body_and_templates(demo, tracker, monkeypatch):
    frame = replace(demo.job("auto", method="auto"), light=SUN)
    tracker.ready(ready_of(frame, SUN))

    def again(*_):
        raise AssertionError("made a second time")

    monkeypatch.setattr(following, "make_bank", again)
    monkeypatch.setattr(following, "LitBody", again)
    assert tracker.track(frame).scorer == "light"


def test_templates_wait_for_a_sun_that_is_not_told_yet(demo, tracker, monkeypatch):
    made = []
    monkeypatch.setattr(following, "make_bank", lambda *given: made.append(given))
    tracker.ready(ready_of(demo.job("auto", method="auto"), None))
    assert not made


def test_a_model_that_the_worker_lacks_is_asked_for(demo, tracker):
    with pytest.raises(MissingBlobError):
        tracker.ready(replace(ready_of(demo.job("auto", method="auto"), SUN), blobs={}))
