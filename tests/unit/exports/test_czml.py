"""CZML: Earth-fixed axes, X Y Z W, one interval per stretch."""

import base64
import io
from dataclasses import replace
from datetime import timedelta

import astropy.units as u
import numpy as np
import pytest
import trimesh
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation, EarthLocation
from astropy.time import Time
from golden import ROTATIONS, START, history
from lit_body import lit_mesh
from scipy.spatial.transform import Rotation

from service.attitude.camera import Site
from service.attitude.orbit import Orbit
from service.exports.czml import czml_packets
from service.exports.czml_model import ROOT
from service.exports.history import Body
from service.inference.articulation import part_transforms
from service.inference.state import Poses
from service.models.mesh_glb import mesh_glb


def test_every_rotation_takes_the_bodys_axes_to_earth_fixed_ones():
    document, packet = czml_packets(history())
    assert (document["id"], packet["id"]) == ("document", "1992-052A")
    intervals = packet["orientation"]
    assert [part["interval"] for part in intervals] == packet["availability"]
    k = 0
    for part in intervals:
        rows = np.array(part["unitQuaternion"]).reshape(-1, 5)
        assert np.all(np.sum(rows[1:, 1:] * rows[:-1, 1:], axis=1) >= 0)
        for seconds, *quaternion in rows:
            moment = Time(part["epoch"].removesuffix("Z"), scale="utc") + seconds * u.s
            axes = Rotation.from_quat(quaternion).as_matrix()  # SciPy's order is X, Y, Z, W too
            for column, expected in zip(axes.T[:2], ROTATIONS[k][1:], strict=True):
                np.testing.assert_allclose(column, earth_fixed(expected, moment), atol=1e-7)
            k += 1
    assert k == len(ROTATIONS)


def earth_fixed(gcrf, moment):
    point = GCRS(CartesianRepresentation(np.array(gcrf) * 7000 * u.km), obstime=moment)
    return point.transform_to(ITRS(obstime=moment)).cartesian.xyz.to_value(u.km) / 7000


def test_a_single_sample_is_a_constant():
    _, packet = czml_packets(history(breaks=(7,)))
    assert len(packet["orientation"][1]["unitQuaternion"]) == 4


TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000"""


def test_where_the_orbit_is_known_the_packet_has_its_place():
    orbit, site = Orbit(TLE), Site(48.2, 16.3, 250.0)
    _, packet = czml_packets(replace(history(), orbit=orbit))
    place = packet["position"]
    rows = np.array(place["cartesian"]).reshape(-1, 4)
    assert len(rows) == len(ROTATIONS)
    ground = EarthLocation.from_geodetic(16.3 * u.deg, 48.2 * u.deg, 250 * u.m)
    for seconds, *metres in rows:
        away = np.array(metres) - [axis.to_value(u.m) for axis in ground.geocentric]
        told = orbit.seen_from(site, START + timedelta(seconds=seconds))
        assert np.linalg.norm(away) == pytest.approx(1e3 * told.range_km, rel=1e-9)
    assert "position" not in czml_packets(history())[1]
    assert len(czml_packets(replace(history(), segments=history().segments[:1], orbit=orbit))[1]["position"]) == 4


def in_cesium(glb: bytes) -> dict[str, np.ndarray]:
    """Each node's vertices as Cesium places them: glTF's z, x, y are its x, y, z."""
    scene = trimesh.load_scene(io.BytesIO(glb), file_type="glb")
    placed = {node: scene.graph[node] for node in scene.graph.nodes_geometry}
    return {
        node: trimesh.transform_points(scene.geometry[mesh].vertices, matrix)[:, [2, 0, 1]]
        for node, (matrix, mesh) in placed.items()
    }


def test_the_body_stands_in_its_own_axes_and_its_parts_move_as_the_joints_did():
    mesh, articulation = lit_mesh()
    body = Body(mesh_glb(mesh, ROOT), articulation, 2.5)
    start = history()
    turned = [replace(one, joints={"panel": 40.0 * k}) for k, one in enumerate(sum(start.segments, ()))]
    told = czml_packets(replace(start, segments=(tuple(turned),), body=body))[1]["model"]
    head, data = told["gltf"].split(",")
    assert (head, told["scale"]) == ("data:model/gltf-binary;base64", 2.5)
    placed = in_cesium(base64.b64decode(data))
    for part in mesh.parts:
        assert np.abs(placed[part.name][:, None] - part.vertices[None]).max(axis=2).min(axis=1).max() < 1e-6
    assert list(told["nodeTransformations"]) == ["panel"]
    moved = told["nodeTransformations"]["panel"]
    where = np.array(moved["translation"]["cartesian"]).reshape(-1, 4)
    how = np.array(moved["rotation"]["unitQuaternion"]).reshape(-1, 5)
    assert (np.sum(how[1:, 1:] * how[:-1, 1:], axis=1) > 0).all()
    for k, (seconds, *place) in enumerate(where):
        at = Poses(np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.zeros(1), np.array([[40.0 * k]]))
        matrix = part_transforms(articulation, at)[0, 2]
        assert seconds == (turned[k].time - START).total_seconds() == how[k, 0]
        assert Rotation.from_quat(how[k, 1:]).as_matrix() == pytest.approx(matrix[:, :3], abs=1e-6)
        assert np.array(place) == pytest.approx(matrix[:, 3], abs=1e-6)


def test_a_body_without_joints_has_no_transformations():
    mesh, articulation = lit_mesh()
    body = Body(mesh_glb(mesh, ROOT), replace(articulation, joints=()), 1.0)
    assert "nodeTransformations" not in czml_packets(replace(history(), body=body))[1]["model"]
    assert "model" not in czml_packets(history())[1]
