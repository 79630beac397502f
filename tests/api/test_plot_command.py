"""``skypose plot`` on a running session: three figures, or one line where matplotlib is missing."""

import asyncio
import sys

import cv2
import httpx
import numpy as np
import pytest
from api_client import Api, served
from fake_worker import CUBE
from typer.testing import CliRunner

from service.cli import app
from service.client import Client

pytestmark = pytest.mark.anyio
RUNNER = CliRunner()


async def test_a_session_becomes_three_figures(make_app, tmp_path):
    from service.cli.figures import corner_figure, orientation_figure, residual_figure

    async with served(make_app()) as host, httpx.AsyncClient(base_url=f"http://{host}") as http:
        api = Api(http)
        session_id = await api.ready_session(CUBE + b"joint", joints={"free": "all"}, camera={"up_angle_deg": 0.0})
        for n in range(3):
            assert (await api.post(session_id, n, ra_deg=10, dec_deg=20)).status_code == 200
        url = f"http://{host}"
        command = ["plot", session_id, "--out", str(tmp_path), "--url", url]
        told = await asyncio.to_thread(RUNNER.invoke, app, command)
        assert told.exit_code == 0, told.output
        for name in ("orientation.png", "corner.png", "residuals.png"):
            assert np.ptp(cv2.imread(str(tmp_path / name))) == 255
        with Client(url) as client:
            estimate, particles, joints = await asyncio.to_thread(
                lambda: (
                    client.estimate(session_id),
                    client.particles(session_id),
                    client.model(client.session(session_id).model_id).joints,
                )
            )
    best = estimate.best.model_copy(update={"orientation": estimate.best.orientation.model_copy(update=UPRIGHT)})
    alone = {name: value[:1] if value.ndim and name != "joint_names" else value for name, value in particles.items()}
    alone |= {"orientation": TURNED, "weights": np.ones(1)}
    here = estimate.model_copy(update={"best": best, "camera": None})
    (panel,) = orientation_figure(here, alone).axes
    rings = [
        (float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in panel.lines if len(line.get_xdata()) == 1
    ]
    np.testing.assert_allclose(rings, [(0, 0), (np.pi / 2, 0), (0, np.pi / 2)], atol=1e-12)
    assert [text.get_text() for text in panel.texts] == ["x", "y", "z"]
    assert all(line.get_markerfacecolor() == "none" for line in panel.lines[-3:])  # the particles within are seen
    corner = corner_figure(here, alone, joints)
    assert corner.axes[-1].get_xlabel() == f"{joints[0].name}, deg"
    drawn = corner.axes[0].patches
    (bar,) = [patch for patch in drawn if patch.get_height()]
    assert bar.get_x() <= 4.0 <= bar.get_x() + bar.get_width()
    residuals = residual_figure([estimate], [estimate]).axes
    assert [float(panel.lines[0].get_ydata()[0]) for panel in residuals[:6]] == pytest.approx([0] * 6, abs=1e-6)


UPRIGHT = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
TURNED = np.array([[np.cos(np.deg2rad(2)), np.sin(np.deg2rad(2)), 0, 0]])  # four degrees about x


async def test_without_matplotlib_one_line_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    told = RUNNER.invoke(app, ["plot", "any", "--out", str(tmp_path)])
    assert told.exit_code == 1 and "pip install matplotlib" in told.output and told.output.count("\n") == 1
