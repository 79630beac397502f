"""deploy/gpu-check: what it makes of drivers that are there, missing, or broken, and when it fails."""

import json
import sys

import pytest

from service.bench import drivers, gpu_check
from service.bench.drivers import describe_drivers, find_drivers
from service.bench.gpu_check import FAILED, NO_GPU, PASSED, Check, main, run_check, verdict_of

ROW = {"backend": "outline", "faces": 7, "size_px": 8, "max_rel_error": 0.5, "agrees": True}
FINE = Check("tests", "pytest", 0, 1.0, "tests.log", "3 passed")


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine with loaders and nothing else; ``loads`` holds the libraries that it has."""
    loads = {"libEGL.so.1", "libGL.so.1"}
    monkeypatch.setattr(drivers, "load_error", lambda name: None if name in loads else f"{name}: not there")
    monkeypatch.setattr(drivers, "_nvidia_smi", lambda: None)
    monkeypatch.setattr(drivers, "_nodes", list)
    monkeypatch.setattr(drivers, "EGL_FOLDERS", (str(tmp_path / "egl"), str(tmp_path / "egl")))
    (tmp_path / "icd").mkdir()
    (tmp_path / "egl").mkdir()
    return loads


def look(tmp_path):
    return find_drivers(tmp_path / "made", {"OCL_ICD_VENDORS": str(tmp_path / "icd")})


def test_a_bare_machine_is_told_what_it_lacks(machine, tmp_path):
    found = look(tmp_path)
    text = "\n".join(found.missing)
    assert "no device file" in text
    assert "an ICD file" in text
    assert "an EGL vendor file" in text
    assert found.environment == {}
    assert "missing: " in "\n".join(describe_drivers(found))


def test_files_of_drivers_are_found_and_broken_ones_named(machine, tmp_path):
    machine |= {"libgood.so", "libEGL_mesa.so.0"}
    (tmp_path / "icd" / "good.icd").write_text("libgood.so\n")
    (tmp_path / "icd" / "gone.icd").write_text("libgone.so\n")
    (tmp_path / "egl" / "50.json").write_text(json.dumps({"ICD": {"library_path": "libEGL_mesa.so.0"}}))
    (tmp_path / "egl" / "60.json").write_text("no json")
    found = look(tmp_path)
    assert found.opencl[str(tmp_path / "icd" / "good.icd")] == "libgood.so"
    assert "not there" in found.opencl[str(tmp_path / "icd" / "gone.icd")]
    assert found.egl[str(tmp_path / "egl" / "50.json")] == "libEGL_mesa.so.0"
    assert "cannot be read" in found.egl[str(tmp_path / "egl" / "60.json")]


def test_drivers_without_their_files_are_used_all_the_same(machine, tmp_path):
    machine |= {"libnvidia-opencl.so.1", "libEGL_nvidia.so.0"}
    (tmp_path / "icd" / "pocl.icd").write_text("libpocl.so\n")
    found = look(tmp_path)
    folder = tmp_path / "made" / "vendors"
    assert found.environment["OCL_ICD_VENDORS"] == str(folder)
    assert sorted(path.name for path in folder.iterdir()) == ["nvidia.icd", "pocl.icd"]
    vendor = json.loads((tmp_path / "made" / "egl_vendor.json").read_text())
    assert vendor["ICD"]["library_path"] == "libEGL_nvidia.so.0"
    assert found.environment["__EGL_VENDOR_LIBRARY_FILENAMES"].startswith(str(tmp_path / "made"))
    assert any("nvidia.icd" in line for line in found.missing)


def test_disagreement_and_failing_tests_fail():
    assert not [line for line in verdict_of([FINE], [ROW]) if line.startswith("FAILED")]
    wrong = verdict_of([FINE], [ROW, {**ROW, "backend": "opengl", "agrees": False}])
    assert [line for line in wrong if line.startswith("FAILED")] == [
        "FAILED: opengl disagrees with the reference: 5.0e-01 at 7 faces, 8 px"
    ]
    red = verdict_of([Check("tests", "pytest", 1, 1.0, "tests.log", "1 failed")], [])
    assert red[0].startswith("FAILED: tests")


def test_what_a_check_prints_is_kept(tmp_path):
    check = run_check("words", [sys.executable, "-c", "print('one'); print('two'); raise SystemExit(5)"], tmp_path, {})
    assert (check.status, check.last_line) == (5, "two")
    assert (tmp_path / "words.log").read_text() == "one\ntwo\n"


@pytest.mark.parametrize(
    ("kind", "options", "status"),
    [("cpu", [], NO_GPU), ("cpu", ["--allow-cpu"], PASSED), ("gpu", [], PASSED), (None, ["--allow-cpu"], NO_GPU)],
)
def test_without_a_gpu_it_goes_on_only_when_told(monkeypatch, tmp_path, kind, options, status):
    device = {"name": "d", "kind": kind, "platform": "p", "rejected": None, "extensions": []}
    found = {"have_gl": False, "devices": [device] if kind else []}
    monkeypatch.setattr(gpu_check, "list_devices", lambda environment: (found, ""))
    monkeypatch.setattr(gpu_check, "plan", lambda out, quick, gpus: [("tests", [sys.executable, "-c", "print('ok')"])])
    assert main(["--out", str(tmp_path), *options]) == status
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["status"] == status
    assert len(report["checks"]) == (status == PASSED)
    assert "skypose gpu-check" in (tmp_path / "report.txt").read_text()


def test_a_failure_is_its_status(monkeypatch, tmp_path):
    found = {
        "have_gl": True,
        "devices": [{"name": "d", "kind": "gpu", "platform": "p", "rejected": None, "extensions": []}],
    }
    monkeypatch.setattr(gpu_check, "list_devices", lambda environment: (found, ""))
    monkeypatch.setattr(
        gpu_check, "plan", lambda out, quick, gpus: [("tests", [sys.executable, "-c", "raise SystemExit(1)"])]
    )
    assert main(["--out", str(tmp_path)]) == FAILED
