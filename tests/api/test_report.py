"""`GET …/report`: one file that tells a pass to people and loads nothing."""

import asyncio
from html.parser import HTMLParser

import httpx
import pytest
from api_client import Api, running, served
from fake_worker import CUBE, FakeWorker
from test_motion import CAMERA, TLE, Turning
from typer.testing import CliRunner

from service.cli import app
from service.errors import BackendMissingError
from service.report.sentences import with_sigma

pytestmark = pytest.mark.anyio


class Page(HTMLParser):
    """Tags and what they point to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.targets, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.targets += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data):
        self.text += data


async def reported(api, session_id: str) -> Page:
    answer = await api.http.get(f"/v1/sessions/{session_id}/report")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "script-src" not in answer.headers["content-security-policy"]
    return Page(answer.text)


async def test_a_pass_among_the_stars(make_app):
    async with running(make_app(Turning)) as api:
        site = {"latitude_deg": 48.2, "longitude_deg": 16.3, "height_m": 250.0}
        camera = {f"site_{name}": value for name, value in site.items()}
        request = {"name": "<script>alert(1)</script>", "prior": {"orbit": TLE}, "camera": camera}
        session_id = await api.ready_session(CUBE, **request)
        here = f"/v1/sessions/{session_id}/report"
        assert (await api.http.get("/v1/sessions/none/report")).status_code == 404
        assert (await api.http.get(here)).status_code == 409
        for n in range(12):
            await api.post(session_id, n, time=f"2026-11-20T03:04:{5 + n / 2:09.6f}Z", **CAMERA)
        page = await reported(api, session_id)
        motion = (await api.http.get(f"/v1/sessions/{session_id}/motion")).json()
        orbit = (await api.http.get(f"/v1/sessions/{session_id}/estimates/0")).json()["orbit"]
    assert "script" not in page.tags
    assert page.targets
    assert all(target.startswith("data:image/webp;base64,") for target in page.targets)
    assert "<script>alert(1)</script>" in page.text
    assert f"once in {with_sigma(motion['period_s'], motion['period_sigma_s'])} s" in page.text
    assert "Right ascension of the body’s axes" in page.text
    assert "in the Earth’s shadow" in page.text
    assert orbit["range_km"] > 0
    assert f"{orbit['range_km']:.1f}" in page.text


async def test_a_single_frame_without_stars(make_app):
    async with running(make_app(Turning)) as api:
        session_id = await api.ready_session(CUBE)
        await api.post(session_id, 0)
        page = await reported(api, session_id)
    assert "How it turned is not known" in page.text
    assert "against the camera" in page.text


async def test_frames_whose_files_are_gone_have_no_picture(make_app):
    async with running(make_app(Turning, keep_frame_bodies=2)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(5):
            await api.post(session_id, n)
        page = await reported(api, session_id)
    assert "Of the first 3 frames no file is kept." in page.text
    assert page.text.count("frame 3,") == page.text.count("frame 4,") == 1
    assert "frame 2," not in page.text


class WithoutOpenCL(FakeWorker):
    """Draws outlines only."""

    def overlay(self, job):
        if set(job.show) - {"overlay", "frame"}:
            raise BackendMissingError("no OpenCL here")
        return super().overlay(job)


async def test_without_opencl_there_are_outlines(make_app):
    async with running(make_app(WithoutOpenCL)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(3):
            await api.post(session_id, n)
        page = await reported(api, session_id)
    assert "No OpenCL here." in page.text
    assert page.tags.count("img") == 4  # three frames and the film


async def test_the_command_writes_a_page_and_prints_it(make_app, tmp_path, monkeypatch):
    """Printed by a browser that is no more than a script here: where a real one is, ``tests/page`` sees the page."""
    browser = tmp_path / "bin" / "chromium"
    browser.parent.mkdir()
    browser.write_text('#!/bin/sh\nfor word; do case $word in --print-to-pdf=*) echo PDF > "${word#*=}";; esac; done\n')
    browser.chmod(0o755)
    async with served(make_app()) as host, httpx.AsyncClient(base_url=f"http://{host}") as http:
        api = Api(http)
        session_id = await api.ready_session(CUBE)
        await api.post(session_id, 0)
        command = ["report", session_id, "--out", str(tmp_path / "pass.html"), "--url", f"http://{host}", "--pdf"]
        monkeypatch.setenv("PATH", str(tmp_path))
        refused = await asyncio.to_thread(CliRunner().invoke, app, command)
        monkeypatch.setenv("PATH", f"{browser.parent}:/usr/bin:/bin")
        told = await asyncio.to_thread(CliRunner().invoke, app, command)
        named = (await http.post("/v1/objects", json={"name": "a box", "sessions": [session_id]})).json()["object_id"]
        page = ["report", "--object", named, "--out", str(tmp_path / "object.html"), "--url", f"http://{host}"]
        of_object = await asyncio.to_thread(CliRunner().invoke, app, page)
        neither = await asyncio.to_thread(CliRunner().invoke, app, ["report", "--url", f"http://{host}"])
    assert of_object.exit_code == 0, of_object.output
    assert "a box" in (tmp_path / "object.html").read_text()
    assert neither.exit_code == 2
    assert refused.exit_code == 1
    assert "needs one of chromium" in refused.output
    assert told.exit_code == 0, told.output
    written = [line for line in told.stdout.splitlines() if line.startswith(str(tmp_path))]  # the server logs there too
    assert written == [str(tmp_path / "pass.html"), str(tmp_path / "pass.pdf")]
    assert (tmp_path / "pass.html").read_text().startswith("<!doctype html>")
    assert (tmp_path / "pass.pdf").read_text() == "PDF\n"
