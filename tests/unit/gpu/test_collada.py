"""COLLADA files among the meshes of a robot: what trimesh writes, what is nested, and what is refused."""

import numpy as np
import pytest
import trimesh

from gpu.collada_file import read_collada
from gpu.mesh_file import read_parts
from gpu.mesh_limits import MeshError, MeshLimitError, MeshLimits
from gpu.urdf_archive import pack_urdf

LIMITS = MeshLimits()
NESTED = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis></asset>
  <library_images><image id="i"><init_from>file:///etc/passwd</init_from></image></library_images>
  <library_geometries><geometry id="g"><mesh>
    <source id="s"><float_array id="f" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
      <technique_common><accessor source="#f" count="4" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
    PRIMITIVES
  </mesh></geometry></library_geometries>
  <library_nodes><node id="two">
    <instance_geometry url="#g"><bind_material><technique_common>
      <instance_material symbol="m" target="#nothing"/></technique_common></bind_material></instance_geometry>
    <node><translate>0 0 3</translate><scale>1 1 -2</scale><instance_geometry url="#g"/></node>
  </node></library_nodes>
  <library_visual_scenes><visual_scene id="w">
    <node><matrix>0 -1 0 10 1 0 0 0 0 0 1 0 0 0 0 1</matrix>INSTANCES</node>
  </visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#w"/></scene>
</COLLADA>"""
CORNERS = '<input semantic="VERTEX" source="#v" offset="0"/>'
POLYGON = f'<polylist count="1">{CORNERS}<vcount>4</vcount><p>0 1 2 3</p></polylist>'
NODE = '<instance_node url="#n{}"/>'
ONE = '<instance_node url="#two"/>'


def nested(primitives: str = POLYGON, instances: str = ONE) -> bytes:
    return NESTED.replace("PRIMITIVES", primitives).replace("INSTANCES", instances).encode()


def test_what_trimesh_writes():
    solid = trimesh.creation.icosphere(1)
    (piece,) = read_collada(trimesh.exchange.dae.export_collada(solid), LIMITS)
    got = trimesh.Trimesh(*piece)
    assert got.is_watertight
    assert got.volume == pytest.approx(solid.volume, rel=1e-5)


def test_nodes_units_and_mirrors():
    """The unit is applied, the up axis is not; a mirrored instance is turned inside out again."""
    flat, mirrored = read_collada(nested(), LIMITS)
    square = 0.0254 * np.array([[10, 0, 0], [10, 1, 0], [9, 1, 0], [9, 0, 0]])
    np.testing.assert_allclose(flat[0], square, atol=1e-9)
    np.testing.assert_allclose(mirrored[0], square + 3 * 0.0254 * np.array([0, 0, 1]), atol=1e-9)
    normals = [np.cross(v[f[0, 1]] - v[f[0, 0]], v[f[0, 2]] - v[f[0, 0]])[2] for v, f in (flat, mirrored)]
    assert normals[0] > 0 > normals[1]


def test_lines_are_left_out():
    lines = f'<lines count="1">{CORNERS}<p>0 1</p></lines>'
    assert len(read_collada(nested(lines + POLYGON), LIMITS)) == 2
    assert read_collada(nested(lines), LIMITS) == []


def test_a_part_of_a_robot():
    robot = b"""<robot name="r"><link name="a"><visual><geometry>
        <mesh filename="package://r/a.dae" scale="2 2 2"/></geometry></visual></link></robot>"""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    data = pack_urdf(robot, {"a.dae": trimesh.exchange.dae.export_collada(box)})
    (part,) = read_parts(data, "urdf")
    np.testing.assert_allclose(np.ptp(part.vertices, axis=0), [2, 4, 6], atol=1e-6)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "COLLADA"),
        (b"PK\x03\x04", "COLLADA"),
        (b"<robot/>", "root element"),
        (b'<!DOCTYPE r [<!ENTITY a "b">]>' + nested(), "document types"),
        (nested().replace(b"0 1 2 3</p>", b"0 1 2 9</p>"), "vertex|index"),
        (nested().replace(b"0 1 2 3</p>", b"0 1 2</p>"), "COLLADA"),
        (nested().replace(b'url="#g"', b'url="#h"'), "COLLADA"),
        (nested().replace(b'<instance_visual_scene url="#w"/>', b""), "no scene"),
        (nested(instances='<instance_controller url="#c"/>'), "skinned"),
        (nested().replace(b"0 0 0 1 0 0", b"0 0 0 x 0 0"), "COLLADA"),
    ],
)
def test_what_is_refused(data, message):
    with pytest.raises(MeshError, match=message):
        read_collada(data, LIMITS)


def test_limits_hold_for_every_instance():
    with pytest.raises(MeshLimitError, match="faces"):
        read_collada(nested(instances=30 * ONE), MeshLimits(faces=100))
    with pytest.raises(MeshLimitError, match="nodes"):
        read_collada(nested(instances=30 * ONE), MeshLimits(nodes=20))
    nodes = "".join(f'<node id="n{k}">{2 * NODE.format(k + 1)}</node>' for k in range(40)) + '<node id="n40"/>'
    bomb = nested(instances=NODE.format(0)).replace(b"<library_nodes>", f"<library_nodes>{nodes}".encode())
    with pytest.raises(MeshLimitError, match="nodes"):
        read_collada(bomb, LIMITS)
    deep = ONE
    for _ in range(9):
        deep = f"<node>{deep}</node>"
    with pytest.raises(MeshLimitError, match="depth"):
        read_collada(nested(instances=deep), MeshLimits(depth=5))
