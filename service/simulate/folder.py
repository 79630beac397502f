"""A simulated pass as a folder: ``case.json``, ``truth.csv``, ``background/``, ``frames/`` and the mesh.

Conventions as everywhere: joints and axes in file coordinates, quaternion body to camera, pixel (0, 0) is the
outer corner of the first pixel.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from service.attitude.absolute import absolute_quaternion
from service.attitude.camera import towards
from service.inference.articulation import Joint
from service.inference.state import Array
from service.simulate.camera import Image
from service.simulate.motion import Track
from service.simulate.overflight import utc_text
from service.simulate.sequence import RANGE_ERROR, SimulatedPass

POINTING = "pointing.csv"
_COAXIAL_TOLERANCE = 1e-6
_UNIT_M = 1.0
_BOX_SHARE, _COVERED = 0.06, 0.5  # of the longer side that a box leaves free; of a pixel that is the body's
_ARCSECOND = np.pi / 648_000


def encode_png(image: Image) -> bytes:
    """PNG bytes of a grey or RGB image, 8 or 16 bits."""
    data = cv2.imencode(".png", image if image.ndim == 2 else image[:, :, ::-1])[1]
    return data.tobytes()


def write_sequence(
    simulated: SimulatedPass,
    folder: Path,
    mesh_name: str,
    mesh_file: bytes,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write everything; existing files of the same names are replaced. ``progress`` hears (done, of)."""
    scenario = simulated.scenario
    total = scenario.background_frames + scenario.motion.frames
    for name in ("background", "frames"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / mesh_name).write_bytes(mesh_file)
    case = json.dumps(describe(simulated, folder.name, mesh_name), indent=1)
    (folder / "case.json").write_text(case + "\n")
    write_truth(simulated, folder / "truth.csv")
    if simulated.looks:
        write_pointing(simulated, folder / POINTING)
    images = [("background", simulated.backgrounds()), ("frames", simulated.frames())]
    done, digits = 0, max(3, len(str(scenario.motion.frames - 1)))  # names stay in order
    for name, source in images:
        for k, image in enumerate(source):
            (folder / name / f"{k:0{digits}d}.png").write_bytes(encode_png(image))
            done += 1
            if progress is not None:
                progress(done, total)


def describe(simulated: SimulatedPass, name: str, mesh_name: str) -> dict[str, Any]:
    """The content of ``case.json``."""
    scenario = simulated.scenario
    return {
        "name": name,
        "mesh": mesh_name,
        "width": scenario.size[0],
        "height": scenario.size[1],
        "frames": scenario.motion.frames,
        "background_frames": scenario.background_frames,
        "bits": scenario.camera.bits,
        "channels": scenario.camera.channels,
        "dt_s": scenario.motion.frame_interval_s,
        "note": scenario.note,
        "materials": scenario.materials,
        **({"path_traced": True} if scenario.path_traced else {}),
        **({"mesh_error": scenario.mesh_error} if scenario.mesh_error else {}),
        "joints": [_joint_entry(simulated, joint) for joint in moving_joints(simulated)],
        "light": {"towards_sun": [round(float(value), 6) for value in simulated.light(0).direction()]},
        "scale_prior": {"px": round(simulated.told_scale, 6), "relative_sigma": RANGE_ERROR},
        **({"box": told_box(simulated)} if scenario.camera.ground else {}),
        **_overflight_entries(simulated),
    }


def told_box(simulated: SimulatedPass) -> list[int]:
    """A box (x, y, width, height) about the body in frame 1, as a person draws it."""
    rows, columns = np.nonzero(simulated.picture(0).coverage > _COVERED)
    spans = int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1
    about = round(_BOX_SHARE * max(spans)) + 1
    return [int(columns.min()) - about, int(rows.min()) - about, spans[0] + 2 * about, spans[1] + 2 * about]


def moving_joints(simulated: SimulatedPass) -> list[Joint]:
    """The joints that differ from the mesh file's rest at some time of the pass, deepest first.

    The listed order is the order of application: what hangs on another part moves before it.
    """
    values = simulated.track.poses.joints
    found = [joint for i, joint in enumerate(simulated.articulation.joints) if np.any(values[:, i] != 0)]
    return sorted(found, key=lambda joint: -max(stage.depth for stage in joint.stages))


def write_truth(simulated: SimulatedPass, path: Path) -> None:
    """The poses of the pass, one line per frame."""
    track: Track = simulated.track
    names = [joint.name for joint in simulated.articulation.joints]
    columns = [(joint.name, names.index(joint.name)) for joint in moving_joints(simulated)]
    header = ["frame", "time_s", "qx", "qy", "qz", "qw", "x_px", "y_px", "scale_px", "visible"]
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(header + [name for name, _ in columns])
        for k, time_s in enumerate(track.time_s):
            pose = track.poses
            w, x, y, z = (round(float(v), 8) for v in pose.quaternion[k])
            place = [round(float(v), 4) for v in pose.position[k]]
            scale = round(float(np.exp(pose.log_scale[k])), 6)
            joints = [round(float(pose.joints[k, i]), 4) for _, i in columns]
            seen = int(track.visible[k])
            out.writerow([k, round(float(time_s), 6), x, y, z, w, *place, scale, seen, *joints])


def write_pointing(simulated: SimulatedPass, path: Path) -> None:
    """Where the camera points and what lies there, one line per frame: coordinates of J2000, without refraction.

    ``gcrf_q…`` is the true attitude as the service tells it, body -> GCRF: relative to the ray to the object.
    """
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        sky = ["ra_deg", "dec_deg", "position_angle_deg"]
        truth = [f"gcrf_q{axis}" for axis in "wxyz"]
        out.writerow(["frame", "time", *sky, "range_km", "elevation_deg", "sunlit", *truth])
        up_deg = simulated.scenario.overflight.up_angle_deg if simulated.scenario.overflight else 0.0
        for k, look in enumerate(simulated.looks):
            angles = [round(look.ra_deg, 7), round(look.dec_deg, 7), up_deg]
            there = [round(look.sighting.range_km, 4), round(look.sighting.elevation_deg, 4), round(look.sunlit, 6)]
            attitude = [round(float(value), 9) for value in true_attitude(simulated, k)]
            out.writerow([k, utc_text(look.moment), *angles, *there, *attitude])


def true_attitude(simulated: SimulatedPass, k: int) -> Array:
    """(4,) quaternion body -> GCRF of frame ``k`` of a pass over a real site."""
    pose = simulated.track.poses
    aside = (pose.position[k] - np.array(simulated.scenario.size) / 2) * np.rad2deg(_radians_per_pixel(simulated))
    axes = towards(simulated.looks[k].camera.to_gcrf, float(aside[0]), float(aside[1]))
    return absolute_quaternion(axes, pose.quaternion[k])


def _radians_per_pixel(simulated: SimulatedPass) -> float:
    first_km = simulated.looks[0].sighting.range_km
    return _UNIT_M / (first_km * 1e3 * float(np.exp(simulated.track.poses.log_scale[0])))


def _overflight_entries(simulated: SimulatedPass) -> dict[str, Any]:
    """What ``case.json`` tells of a real pass. The mesh's unit is taken for a metre."""
    over = simulated.scenario.overflight
    if over is None:
        return {}
    radians = _radians_per_pixel(simulated)
    return {
        "site": {
            "latitude_deg": over.site.latitude_deg,
            "longitude_deg": over.site.longitude_deg,
            "height_m": over.site.height_m,
        },
        "tle": over.elements,
        "time": utc_text(over.start),
        "pointing": POINTING,
        "camera": {"up_angle_deg": over.up_angle_deg, "pixel_scale_arcsec": round(radians / _ARCSECOND, 8)},
        "unit_m": _UNIT_M,
    }


def _joint_entry(simulated: SimulatedPass, joint: Joint) -> dict[str, Any]:
    """One axis for the whole joint, which is all that the form can say: stages must turn alike."""
    first = joint.stages[0]
    for stage in joint.stages[1:]:
        offset = np.subtract(stage.origin, first.origin)
        aside = np.linalg.norm(np.cross(offset, first.axis)) if joint.kind == "revolute" else 0.0
        turned = np.linalg.norm(np.subtract(stage.axis, first.axis))
        if stage.ratio != 1 or turned > _COAXIAL_TOLERANCE or aside > _COAXIAL_TOLERANCE * simulated.mesh.radius:
            raise ValueError(f"joint {joint.name!r} has stages that turn differently; leave it at rest")
    return {
        "name": joint.name,
        "nodes": [part for stage in joint.stages for part in stage.parts],
        "axis": list(first.axis),
        "origin": (np.asarray(first.origin) + simulated.mesh.centre).tolist(),
        "kind": joint.kind,
        "min": joint.minimum,
        "max": joint.maximum,
    }
