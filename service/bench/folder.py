"""Cases from a folder: ``case.json``, ``truth.csv``, ``background/*.png``, ``frames/*.png`` in each of its folders."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from service.bench.cases import Case, ModelShelf, TruthFrame
from service.bench.overflights import LitOverflight
from service.inference.light import Light
from service.inference.state import Array


class SequenceError(ValueError):
    """A folder is no benchmark sequence; the message says what is missing."""


@dataclass(frozen=True)
class SequenceFolder:
    """One sequence on disk. ``meshes`` are further places where its mesh may lie.

    ``untied_deg``: every joint of the file is one of its own, known within so many degrees; None: ties hold.
    """

    path: Path
    meshes: tuple[Path, ...] = ()
    untied_deg: float | None = None

    def case(self, shelf: ModelShelf) -> Case:
        """Read what describes the pass and prepare its model; the frames are read later, one by one."""
        described = json.loads((self.path / "case.json").read_text())
        if self.untied_deg is not None:
            described = untied(described, self._rows(), self.untied_deg)
        file = self.mesh(described["mesh"])
        upload, names = upload_joints(described)
        model = shelf.model(file.name, file.read_bytes(), upload)
        return Case(
            name=str(described["name"]),
            model=model,
            free=names,
            size=(int(described["width"]), int(described["height"])),
            backgrounds=self._backgrounds,
            frames=lambda: self._frames(names, described),
            symmetries=listed_symmetries(file, described.get("symmetry", ())),
            facts=_facts(described.get("note", "")),
            towards_sun=_direction(described.get("light", {}).get("towards_sun")),
            box=_box(described.get("box")),
            scale_prior=_scale_prior(described.get("scale_prior")),
            mesh_error=float(described.get("mesh_error", 0.0)),
        )

    def _backgrounds(self) -> Iterator[bytes]:
        for path in sorted((self.path / "background").glob("*.png")):
            yield path.read_bytes()

    def _frames(self, names: Sequence[str], described: Mapping[str, Any]) -> Iterator[tuple[bytes, TruthFrame]]:
        numbers = [path.stem for path in (self.path / "frames").glob("*.png") if path.stem.isdecimal()]
        digits = min(map(len, numbers), default=3)
        lights: Iterable[Light | None] = repeat(None)
        if "pointing" in described:
            lights = map(LitOverflight(described).light, self._rows(described["pointing"]))
        for k, (row, light) in enumerate(zip(self._rows(), lights, strict="pointing" in described)):
            body = (self.path / "frames" / f"{k:0{digits}d}.png").read_bytes()
            yield body, replace(_truth(row, names), light=light)

    def _rows(self, name: str = "truth.csv") -> Iterator[dict[str, str]]:
        with (self.path / name).open(newline="") as file:
            yield from csv.DictReader(file)

    def mesh(self, name: str) -> Path:
        """Where the mesh of that name lies. Raises ``SequenceError``."""
        roots = (*self.meshes, self.path, *self.path.resolve().parents[:3])
        for root in roots:
            for candidate in (root / name, root / Path(name).name, root / "meshes" / Path(name).name):
                if candidate.is_file():
                    return candidate
        raise SequenceError(f"{self.path.name}: no mesh {name} in {', '.join(str(root) for root in roots)}")


def find_sequences(
    folder: Path, names: Sequence[str] = (), meshes: Path | None = None, untied_deg: float | None = None
) -> list[SequenceFolder]:
    """The sequences of a folder in the order of their names, or the folder itself if it is one.

    Raises ``SequenceError`` where there is none, or none of a wanted name.
    """
    found = [folder] if (folder / "case.json").is_file() else sorted(p.parent for p in folder.glob("*/case.json"))
    if not found:
        raise SequenceError(f"{folder} holds no sequence: no case.json in it or in a folder of it")
    for name in names:
        if name not in [path.name for path in found]:
            raise SequenceError(f"no sequence {name!r}; there are {', '.join(path.name for path in found)}")
    extra = () if meshes is None else (meshes,)
    return [SequenceFolder(path, extra, untied_deg) for path in found if not names or path.name in names]


def listed_symmetries(mesh: Path, told: Sequence[Any] = ()) -> tuple[Array, ...] | None:
    """The orthogonal matrices that ``symmetry.json`` beside a mesh lists for it, and those that its case tells.

    None where there is neither.
    """
    file = mesh.parent / "symmetry.json"
    listed = json.loads(file.read_text()) if file.is_file() else {}
    if mesh.name not in listed and not told:
        return None
    return tuple(np.array(matrix, dtype=np.float64) for matrix in (*listed.get(mesh.name, ()), *told))


def _facts(note: str) -> dict[str, float]:
    """What a note says of the air: ``calm``, or its D/r0."""
    found = re.search(r"D/r0 (\d+(?:\.\d+)?)", note)
    if found:
        return {"d_over_r0": float(found[1])}
    return {"d_over_r0": 0.0} if "calm" in note else {}


def _direction(listed: Sequence[float] | None) -> Array | None:
    return None if listed is None else np.array(listed, dtype=np.float64)


def _box(listed: Sequence[float] | None) -> tuple[float, float, float, float] | None:
    if listed is None:
        return None
    x, y, width, height = (float(value) for value in listed)
    return x, y, width, height


def _scale_prior(described: Mapping[str, float] | None) -> tuple[float, float] | None:
    return None if described is None else (float(described["px"]), float(described["relative_sigma"]))


def upload_joints(described: Mapping[str, Any]) -> tuple[tuple[Mapping[str, Any], ...] | None, tuple[str, ...]]:
    """``joints`` of an upload, and the names of those that are free, from a ``case.json``."""
    joints = tuple(_upload_entry(joint) for joint in described.get("joints", []))
    ties = described.get("ties", {})  # follower -> leader, both joints of the mesh file itself
    upload = tuple({"name": name, "tied_to": leader, "ratio": 1} for name, leader in ties.items()) or joints
    return upload or None, tuple(str(joint["name"]) for joint in joints if joint["name"] not in ties)


def untied(described: Mapping[str, Any], rows: Iterable[Mapping[str, str]], degrees: float) -> dict[str, Any]:
    """A ``case.json`` in which all joints move on their own, each within ``degrees`` of where it is in these rows."""
    seen, joints = list(rows), []
    for joint in described.get("joints", []):
        values = [float(row[joint["name"]]) for row in seen]
        joints.append({**joint, "min": min(values) - degrees, "max": max(values) + degrees})
    return {**described, "joints": joints, "ties": {}}


def _upload_entry(joint: Mapping[str, Any]) -> dict[str, Any]:
    """A joint of ``case.json`` as an upload says it."""
    return {
        "name": joint["name"],
        "kind": joint.get("kind", "revolute"),
        "parts": joint["nodes"],
        "axis": joint["axis"],
        "origin": joint.get("origin", [0, 0, 0]),
        "min": joint.get("min", -180),
        "max": joint.get("max", 180),
    }


def _truth(row: Mapping[str, str], names: Sequence[str]) -> TruthFrame:
    return TruthFrame(
        time_s=float(row["time_s"]),
        quaternion=np.array([float(row[column]) for column in ("qw", "qx", "qy", "qz")]),
        position=np.array([float(row["x_px"]), float(row["y_px"])]),
        scale=float(row["scale_px"]),
        joints={name: float(row[name]) for name in names},
        visible=row["visible"] == "1",
    )
