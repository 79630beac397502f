"""URDF: a robot description (http://wiki.ros.org/urdf/XML) as links at rest and the joints between them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gpu.mesh_limits import MeshError, MeshLimits, require
from gpu.xml_document import read_xml

Matrix = NDArray[np.float64]
LARGEST_NUMBER = 1e12  # as of coordinates


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the file. ``place`` is the joint's frame in file coordinates (the root link's), all joints at 0."""

    name: str
    kind: str
    parent: str
    child: str
    place: Matrix  # (4, 4)
    axis: tuple[float, float, float]  # in that frame
    lower: float | None  # rad or m
    upper: float | None
    mimic: tuple[str, float, float] | None  # joint, multiplier, offset


@dataclass(frozen=True)
class UrdfRobot:
    """Links in file order, each with its place at rest, and the joints."""

    links: Mapping[str, Matrix]  # (4, 4) link -> file coordinates
    joints: tuple[UrdfJoint, ...]
    root: ElementTree.Element
    subtrees: Mapping[str, Sequence[str]]  # a link and all that hang on it
    depths: Mapping[str, int]  # joints between a link and the root

    def below(self, link: str) -> frozenset[str]:
        """A link and all that hang on it."""
        return frozenset(self.subtrees[link])

    def depth(self, link: str) -> int:
        """How many joints lie between a link and the root."""
        return self.depths[link]


def read_urdf(document: bytes, limits: MeshLimits) -> UrdfRobot:
    """Links and joints, placed with every joint at 0 (one that mimics another at its offset). Raises ``MeshError``."""
    require(limits, json_bytes=len(document))
    root = read_xml(document, "URDF")
    if root.tag != "robot":
        raise MeshError(f"URDF: the root element is <{root.tag}>, not <robot>")
    listed = [name_of(link, "link") for link in root.findall("link")]
    names = dict.fromkeys(listed)  # in file order, and quick to ask
    elements = root.findall("joint")
    require(limits, nodes=len(listed) + len(elements))
    if not names or len(names) < len(listed):
        raise MeshError("URDF: there is no link, or two of one name")
    parents = {_ends(element, names)[1]: element for element in elements}
    if len(parents) < len(elements):
        raise MeshError("URDF: a link is the child of two joints")
    places: dict[str, Matrix] = {}
    for name in names:
        _place(name, parents, names, places, limits)
    joints = tuple(_joint(element, names, places) for element in elements)
    subtrees, depths = _hierarchy(names, joints)
    require(limits, depth=max(depths.values()))
    return UrdfRobot({name: places[name] for name in names}, joints, root, subtrees, depths)


def _hierarchy(
    names: Collection[str], joints: Sequence[UrdfJoint]
) -> tuple[Mapping[str, Sequence[str]], Mapping[str, int]]:
    """Of every link all that hang on it, itself included, and how many joints lie above it."""
    above = {joint.child: joint.parent for joint in joints}
    subtrees: dict[str, list[str]] = {name: [] for name in names}
    depths: dict[str, int] = {}
    for name in names:
        chain = [name]
        while chain[-1] in above:
            chain.append(above[chain[-1]])
        for link in chain:
            subtrees[link].append(name)
        depths[name] = len(chain) - 1
    return subtrees, depths


def name_of(element: ElementTree.Element, what: str) -> str:
    """Its name. Raises ``MeshError``."""
    name = element.get("name", "").strip()
    if not name:
        raise MeshError(f"URDF: a {what} has no name")
    return name


def origin_of(element: ElementTree.Element) -> Matrix:
    """(4, 4) of its <origin>: fixed axes roll, pitch, yaw (rad), then xyz (m). Raises ``MeshError``."""
    origin = element.find("origin")
    out = np.eye(4)
    if origin is not None:
        roll, pitch, yaw = numbers(origin, "rpy", (0.0, 0.0, 0.0))
        out[:3, :3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
        out[:3, 3] = numbers(origin, "xyz", (0.0, 0.0, 0.0))
    return out


def numbers(element: ElementTree.Element, key: str, default: Sequence[float]) -> list[float]:
    """As many numbers of an attribute as ``default`` has. Raises ``MeshError``."""
    text = element.get(key)
    try:
        values = list(default) if text is None else [float(part) for part in text.split()]
    except ValueError as error:
        raise MeshError(f"URDF: <{element.tag} {key}={text!r}> is no list of numbers") from error
    if len(values) != len(default) or not np.all(np.abs(values) <= LARGEST_NUMBER):
        raise MeshError(
            f"URDF: <{element.tag} {key}={text!r}> must be {len(default)} finite numbers, at most {LARGEST_NUMBER:g}"
        )
    return values


def _ends(element: ElementTree.Element, names: Collection[str]) -> tuple[str, str]:
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        link = "" if end is None else end.get("link", "")
        if link not in names:
            raise MeshError(f"URDF: joint {element.get('name')!r}: its {tag} {link!r} is no link")
        ends.append(link)
    return ends[0], ends[1]


def _place(
    name: str,
    parents: Mapping[str, ElementTree.Element],
    names: Collection[str],
    places: dict[str, Matrix],
    limits: MeshLimits,
) -> None:
    """Fill in the place of a link and of all above it."""
    chain = [name]
    while chain[-1] in parents and chain[-1] not in places:
        chain.append(_ends(parents[chain[-1]], names)[0])
        require(limits, depth=len(chain) - 1)
        if len(chain) > len(names):
            raise MeshError("URDF: the links form a circle")
    for link in reversed(chain):
        if link in places:
            continue
        element = parents.get(link)
        if element is None:
            places[link] = np.eye(4)
        else:
            frame = places[_ends(element, names)[0]] @ origin_of(element)
            places[link] = frame @ _offset_motion(element)


def _offset_motion(element: ElementTree.Element) -> Matrix:
    """(4, 4) of a joint that mimics another one's 0: the identity for any other."""
    mimic = element.find("mimic")
    offset = 0.0 if mimic is None else numbers(mimic, "offset", (0.0,))[0]
    axis = np.asarray(_axis(element))
    out = np.eye(4)
    if element.get("type") == "prismatic":
        out[:3, 3] = offset * axis
    else:
        out[:3, :3] = Rotation.from_rotvec(offset * axis).as_matrix()
    return out


def _axis(element: ElementTree.Element) -> tuple[float, float, float]:
    found = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0] if found is None else numbers(found, "xyz", (1.0, 0.0, 0.0)))
    length = float(np.linalg.norm(axis))
    if length == 0:
        raise MeshError(f"URDF: joint {element.get('name')!r}: its axis is zero")
    x, y, z = (float(v) for v in axis / length)
    return x, y, z


def _joint(element: ElementTree.Element, names: Collection[str], places: Mapping[str, Matrix]) -> UrdfJoint:
    name = name_of(element, "joint")
    parent, child = _ends(element, names)
    limit, mimic = element.find("limit"), element.find("mimic")
    bounded = limit is not None and (limit.get("lower") is not None or limit.get("upper") is not None)
    return UrdfJoint(
        name=name,
        kind=element.get("type", ""),
        parent=parent,
        child=child,
        place=places[parent] @ origin_of(element),
        axis=_axis(element),
        lower=numbers(limit, "lower", (0.0,))[0] if bounded and limit is not None else None,
        upper=numbers(limit, "upper", (0.0,))[0] if bounded and limit is not None else None,
        mimic=None
        if mimic is None
        else (mimic.get("joint", ""), numbers(mimic, "multiplier", (1.0,))[0], numbers(mimic, "offset", (0.0,))[0]),
    )
