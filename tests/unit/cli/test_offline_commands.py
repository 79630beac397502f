"""``skypose simulate`` and ``skypose track`` on files: what goes in, what comes out, what is refused."""

import csv
import json
import struct
from datetime import datetime

import cv2
import numpy as np
import pytest
from astropy.io import fits
from brahe.ccsds import AEM
from typer.testing import CliRunner

from service.cli import app
from service.cli.demo_pass import FrameResult, judge
from service.cli.images import open_images
from service.cli.options import choose_joints, parse_box, parse_size
from service.simulate.compare import PoseErrors

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("pass")
    arguments = ["simulate", "--out", str(out), "--frames", "3", "--size", "96x96", "--preset", "demo", "--json"]
    result = RUNNER.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["frames"] == 3
    return out


def test_simulate_writes_what_the_benchmark_reads(folder):
    case = json.loads((folder / "case.json").read_text())
    assert (case["mesh"], case["frames"], case["width"]) == ("demo.glb", 3, 96)
    assert (folder / "demo.glb").read_bytes()[:4] == b"glTF"
    assert sorted(p.name for p in (folder / "frames").iterdir()) == ["000.png", "001.png", "002.png"]


def test_random_passes_go_round_the_meshes(folder, tmp_path):
    meshes = ["--mesh", "demo", "--mesh", str(folder / "demo.glb")]
    arguments = ["simulate", "--out", str(tmp_path), "--random", "3", "--frames", "1", "--size", "64x64", *meshes]
    assert RUNNER.invoke(app, arguments).exit_code == 0
    notes = [json.loads((tmp_path / f"pass_{k:03d}" / "case.json").read_text())["note"] for k in range(3)]
    assert notes == ["random pass 0", "random pass 1", "random pass 2"]


def test_mixed_random_passes_are_another_draw(tmp_path):
    arguments = ["simulate", "--out", str(tmp_path), "--random", "1", "--frames", "1", "--materials", "mixed"]
    assert RUNNER.invoke(app, arguments).exit_code == 0
    case = json.loads((tmp_path / "pass_000" / "case.json").read_text())
    assert (case["materials"], case["width"], case["background_frames"]) == ("mixed", 192, 6)
    assert case["note"].startswith("random mixed pass 0: phase ")


def test_track_writes_estimates_and_a_sheet(folder, tmp_path):
    arguments = ["track", "--mesh", "demo", "--background", str(folder / "background")]
    arguments += [
        "--frames",
        str(folder / "frames"),
        "--out",
        str(tmp_path),
        "--preset",
        "paper",
        "--particles",
        "50",
        "--json",
    ]
    result = RUNNER.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["frames"], sum(told["statuses"].values()), told["out"]) == (3, 3, str(tmp_path))
    with (tmp_path / "estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    if "no motion.json" not in result.output:
        assert json.loads((tmp_path / "motion.json").read_text())["frames"]["stored"] == 3
    lines = [json.loads(line) for line in (tmp_path / "estimates.jsonl").read_text().splitlines()]
    assert [row["name"] for row in rows] == ["000.png", "001.png", "002.png"]
    for k, (row, line) in enumerate(zip(rows, lines, strict=True)):
        assert line["index"] == int(row["index"]) == k
        assert row["time"] == line["time"]
        assert float(row["qx"]) == line["best"]["orientation"]["x"]
        assert float(row["joint:wing_deg"]) == line["best"]["joints"]["wing"]
        assert line["particles"] == 50
    assert cv2.imread(str(tmp_path / "contact_sheet.png")).shape[0] > 2 * 256


def test_without_empty_frames_the_sky_is_that_around_the_body(folder, tmp_path):
    arguments = ["track", "--mesh", "demo", "--frames", str(folder / "frames"), "--out", str(tmp_path)]
    elsewhere = {"SKYPOSE_DATABASE_URL": "postgresql+psycopg://nobody@127.0.0.1:1/none"}  # of another service
    told = RUNNER.invoke(app, [*arguments, "--preset", "paper", "--particles", "50"], env=elsewhere)
    assert told.exit_code == 0, told.output
    lines = [json.loads(line) for line in (tmp_path / "estimates.jsonl").read_text().splitlines()]
    assert [line["assumed"] for line in lines] == [["background", "time"]] * 3


def test_a_file_of_several_frames_is_posted_whole(folder, tmp_path):
    frames = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((folder / "frames").iterdir())]
    np.save(tmp_path / "stack.npy", np.stack(frames))
    arguments = ["track", "--mesh", "demo", "--frames", str(tmp_path / "stack.npy"), "--out", str(tmp_path / "out")]
    arguments += ["--start", "2026-11-20T03:04:05Z", "--interval", "0.5", "--preset", "paper", "--particles", "50"]
    told = RUNNER.invoke(app, arguments)
    assert told.exit_code == 0 and "no attitude.aem" in told.output, told.output
    with (tmp_path / "out" / "estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [f"stack.npy#{k}" for k in range(3)]
    assert [row["time"] for row in rows] == [f"2026-11-20T03:04:{second}Z" for second in ("05.000", "05.500", "06.000")]
    assert cv2.imread(str(tmp_path / "out" / "contact_sheet.png")).shape[0] > 2 * 256


TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)


def test_run_makes_an_attitude_file_of_a_folder_of_fits(tmp_path, monkeypatch):
    monkeypatch.setattr("service.sessions.consistency._OLD_DAYS", 1.0)
    (tmp_path / "iss.tle").write_text(TLE)
    seen = ["--site", "48.23,16.34,250", "--tle", str(tmp_path / "iss.tle")]
    when = ["--time", "2019-12-11T15:05:00Z", "--up-angle", "25"]
    simulate = ["simulate", "--out", str(tmp_path), "--frames", "2", "--size", "96x96", *seen, *when]
    assert RUNNER.invoke(app, simulate).exit_code == 0
    with (tmp_path / "pointing.csv").open() as file:
        truth = list(csv.DictReader(file))
    (tmp_path / "fits").mkdir()
    for k, row in enumerate(truth):
        pixels = cv2.imread(str(tmp_path / "frames" / f"{k:03d}.png"), cv2.IMREAD_UNCHANGED)
        hdu = fits.PrimaryHDU(pixels[::-1])  # FITS counts its rows from the bottom
        cards = {"DATE-AVG": row["time"].rstrip("Z"), "RA": float(row["ra_deg"]), "DEC": float(row["dec_deg"])}
        hdu.header.update(cards)
        hdu.writeto(tmp_path / "fits" / f"{k}.fits")
    out = tmp_path / "pass"
    run = ["run", "--mesh", "demo", "--frames", str(tmp_path / "fits"), "--out", str(out), "--preset", "paper"]
    told = RUNNER.invoke(app, [*run, *seen, "--up-angle", "25", "--particles", "1000", "--smoothed"])
    assert told.exit_code == 0, told.output
    assert "the orbit's elements are 2 days from the frame (2 frames)" in " ".join(told.output.split())
    with (out / "estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["0.fits", "1.fits"]
    assert [datetime.fromisoformat(row["time"]) for row in rows] == [datetime.fromisoformat(r["time"]) for r in truth]
    text = (out / "attitude.aem").read_text()
    assert "OBJECT_NAME = demo\n" in text
    states = [state for one in AEM.from_str(text).segments for state in one.states]
    assert len(states) == sum(row["status"] in ("acquiring", "ambiguous", "tracking") for row in rows)
    first = json.loads((out / "estimates.jsonl").read_text().splitlines()[0])
    assert first["orbit"]["range_km"] == pytest.approx(float(truth[0]["range_km"]), abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--box", "1,2,3"], "no box"),
        (["--border", "8", "--box", "1,2,3,4"], "one of --background, --box, --border"),
        (["--border", "8", "--free", "flap"], "no joint 'flap'"),
        (["--border", "8", "--joints", "[{}]"], "joints[0].name"),
        (["--border", "8", "--preset", "best"], "preset"),
        (["--border", "8", "--mesh", "nowhere.glb"], "nowhere.glb"),
    ],
)
def test_track_refuses_with_the_reason(folder, tmp_path, arguments, message):
    base = ["track", "--mesh", "demo", "--frames", str(folder / "frames"), "--out", str(tmp_path)]
    result = RUNNER.invoke(app, base + arguments, env={"COLUMNS": "200", "TERM": "dumb"})
    assert result.exit_code != 0
    assert message in result.output


def test_a_video_is_read_frame_by_frame(tmp_path):
    path = tmp_path / "pass.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for k in range(4):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()
    source = open_images(path)
    assert source.interval_s == pytest.approx(0.05)
    images = [cv2.imdecode(np.frombuffer(image.body, np.uint8), cv2.IMREAD_COLOR) for image in source]
    assert [round(float(image.mean()) / 40) for image in images] == [0, 1, 2, 3]


def test_a_file_of_several_frames_is_taken_apart(tmp_path):
    stack = np.random.default_rng(3).integers(0, 60_000, (3, 8, 12), dtype=np.uint16)
    np.save(tmp_path / "b.npy", stack)
    header = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, 12, 8, 16, 3, b"", b"", b"", 0, 0)
    (tmp_path / "c.ser").write_bytes(header + stack.tobytes())
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", stack[0])[1].tobytes())
    source = open_images(tmp_path)
    assert source.count is None
    assert [image.name for image in source] == [
        "a.png",
        *(f"b.npy#{k}" for k in range(3)),
        *(f"c.ser#{k}" for k in range(3)),
    ]
    for image, expected in zip(open_images(tmp_path / "c.ser"), stack, strict=True):
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(image.body, np.uint8), cv2.IMREAD_UNCHANGED), expected)


def test_option_values():
    assert parse_size("320X240") == (320, 240)
    assert parse_box("1,2.5,30,40") == (1.0, 2.5, 30.0, 40.0)
    many = tuple("abcd")
    assert choose_joints(None, many) == ()
    assert choose_joints(None, many[:3]) == many[:3]
    assert choose_joints("all", many) == many
    assert choose_joints("none", many[:1]) == ()
    assert choose_joints("d, a", many) == ("d", "a")


def test_the_demo_is_lost_by_angle_or_by_overlap():
    def results(angle, iou):
        start = [FrameResult(k, {}, PoseErrors(90.0, 0, 0, 0, 0.1)) for k in range(10)]
        return [*start, *(FrameResult(k, {}, PoseErrors(angle(k), 0, 0, 0, iou)) for k in range(10, 20))]

    assert judge(results(lambda k: 1.0, 0.9)).held
    assert judge(results(lambda k: 9.0 if k < 12 else 1.0, 0.9)).held
    assert not judge(results(lambda k: 9.0 if k < 13 else 1.0, 0.9)).held
    assert not judge(results(lambda k: 1.0, 0.8)).held
