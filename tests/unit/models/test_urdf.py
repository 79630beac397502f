"""URDF models: what stands where at every joint value, tied joints, mesh files, and what is refused."""

import io
import zipfile

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from gpu.mesh import MeshError, load_mesh
from gpu.mesh_file import read_parts
from gpu.mesh_limits import MeshLimitError, MeshLimits
from gpu.urdf_archive import pack_urdf
from service.errors import JointError
from service.inference.articulation import part_transforms
from service.inference.state import Poses
from service.models.articulations import read_joints

SATELLITE = b"""<?xml version="1.0"?>
<robot name="sat">
  <link name="bus">
    <visual><origin xyz="0.1 0 0" rpy="0 0 0.3"/><geometry><box size="1 0.8 1.2"/></geometry></visual>
    <visual><origin xyz="0 0 0.8"/><geometry><cylinder radius="0.2" length="0.4"/></geometry></visual>
  </link>
  <link name="yoke"><visual><geometry><box size="0.1 0.6 0.1"/></geometry></visual></link>
  <link name="left"><visual><origin xyz="0 1 0"/><geometry><mesh filename="package://sat/panel.stl"/></geometry></visual></link>
  <link name="right">
    <visual><geometry><mesh filename="../meshes/panel.stl" scale="1 -1 2"/></geometry></visual>
  </link>
  <link name="boom"><collision><geometry><box size="9 9 9"/></geometry></collision></link>
  <link name="tip"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <joint name="swing" type="revolute">
    <parent link="bus"/><child link="yoke"/><origin xyz="0 0.7 0" rpy="0.2 -0.1 0.4"/>
    <axis xyz="0 0 2"/><limit lower="-1.5" upper="1.0" effort="1" velocity="1"/>
  </joint>
  <joint name="drive" type="continuous">
    <parent link="yoke"/><child link="left"/><origin xyz="0 0.3 0"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="drive_right" type="continuous">
    <parent link="bus"/><child link="right"/><origin xyz="0 -0.7 0" rpy="0 0 0.1"/>
    <axis xyz="0 1 0"/><mimic joint="drive" multiplier="-1" offset="0.5"/>
  </joint>
  <joint name="mast" type="prismatic">
    <parent link="bus"/><child link="boom"/><axis xyz="1 0 1"/><limit lower="-0.2" upper="0.7"/>
  </joint>
  <joint name="weld" type="fixed"><parent link="boom"/><child link="tip"/><origin xyz="1 0 0" rpy="0 0.4 0"/></joint>
</robot>"""


def panel() -> bytes:
    file = io.BytesIO()
    solid = trimesh.creation.box((0.5, 1.6, 0.02))
    solid.apply_translation((0.1, 0.2, 0.0))
    solid.export(file, file_type="stl")
    return file.getvalue()


PACKED = pack_urdf(SATELLITE, {"panel.stl": panel()})
PANEL = trimesh.load(io.BytesIO(panel()), file_type="stl").vertices


def placed(data: bytes, joints: list | None = None, **values: float) -> dict[str, np.ndarray]:
    """Vertices of every part in file coordinates, through everything that the tracker uses."""
    mesh = load_mesh(data, "urdf")
    articulation = read_joints(data, "urdf", mesh, joints).articulation
    column = np.array([[values.get(joint.name, joint.initial) for joint in articulation.joints]])
    pose = Poses(np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.zeros(1), column)
    motions = part_transforms(articulation, pose)[0].astype(np.float64)
    return {
        part.name: part.vertices @ m[:, :3].T + m[:, 3] + mesh.centre
        for part, m in zip(mesh.parts, motions, strict=True)
    }


def frame(xyz, rpy=(0, 0, 0)) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
    return out


def turn(angle_rad: float, axis) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(angle_rad * np.asarray(axis)).as_matrix()
    return out


def same_points(found: np.ndarray, points: np.ndarray, place: np.ndarray) -> None:
    """As sets: the mesh was cleaned on its way."""
    expected = points @ place[:3, :3].T + place[:3, 3]
    found, expected = (np.unique(np.round(p, 5) + 0.0, axis=0) for p in (found, expected))
    np.testing.assert_allclose(found, expected, atol=2e-5)


@pytest.mark.parametrize(("swing", "drive", "mast"), [(0, 0, 0), (0.8, -1.1, 0.5), (-1.4, 3.0, -0.1)])
def test_links_stand_where_the_joints_put_them(swing, drive, mast):
    found = placed(PACKED, swing=np.rad2deg(swing), drive=np.rad2deg(drive), mast=mast)
    assert list(found) == ["bus", "yoke", "left", "right", "tip"]  # the boom is not seen
    yoke = frame((0, 0.7, 0), (0.2, -0.1, 0.4)) @ turn(swing, (0, 0, 1))
    same_points(found["yoke"], trimesh.creation.box((0.1, 0.6, 0.1)).vertices, yoke)
    same_points(found["left"], PANEL, yoke @ frame((0, 0.3, 0)) @ turn(drive, (0, 1, 0)) @ frame((0, 1, 0)))
    right = frame((0, -0.7, 0), (0, 0, 0.1)) @ turn(0.5 - drive, (0, 1, 0))
    same_points(found["right"], PANEL * (1, -1, 2), right)
    slide = frame(mast * np.array([1, 0, 1]) / np.sqrt(2))
    same_points(found["tip"], trimesh.creation.icosphere(3, 0.1).vertices, slide @ frame((1, 0, 0), (0, 0.4, 0)))


def test_joints_have_the_files_ranges_in_degrees_and_a_mimicking_one_is_no_variable():
    mesh = load_mesh(PACKED, "urdf")
    found = read_joints(PACKED, "urdf", mesh)
    joints = {joint.name: joint for joint in found.articulation.joints}
    assert list(joints) == ["swing", "drive", "mast"]
    assert (joints["swing"].minimum, joints["swing"].maximum) == pytest.approx(np.rad2deg([-1.5, 1.0]))
    assert joints["drive"].period == 360 and len(joints["drive"].stages) == 2
    assert joints["mast"].maximum == 0.7
    assert mesh.watertight and not found.warnings
    odd = SATELLITE.replace(b'multiplier="-1"', b'multiplier="0"').replace(
        b'"swing" type="revolute"', b'"swing" type="planar"'
    )
    data = pack_urdf(odd, {"panel.stl": panel()})
    free = read_joints(data, "urdf", mesh)
    assert [joint.name for joint in free.articulation.joints] == ["drive", "drive_right", "mast"]
    assert ["planar" in free.warnings[0], "multiplier 0" in free.warnings[1]] == [True, True]


def test_ties_of_the_upload_leave_the_files_joints():
    data = pack_urdf(
        SATELLITE.replace(b'<mimic joint="drive" multiplier="-1" offset="0.5"/>', b""), {"panel.stl": panel()}
    )
    tie = [{"name": "drive_right", "tied_to": "drive", "ratio": -1}]
    tied, free = placed(data, tie, drive=40), placed(data, drive=40, drive_right=-40)
    assert all(np.array_equal(tied[name], free[name]) for name in free)
    for wrong, field in (
        ({"name": "drive", "tied_to": "mast"}, "tied_to"),
        ({"name": "wing", "tied_to": "mast"}, "name"),
        ({"name": "drive", "tied_to": "drive_right", "ratio": 0}, "ratio"),
        ({"name": "drive", "tied_to": "drive_right", "axis": [1, 0, 0]}, "axis"),
    ):
        with pytest.raises(JointError) as caught:
            placed(data, [wrong])
        assert caught.value.field == f"joints[0].{field}"


@pytest.mark.parametrize(("ratio", "period"), [(2.0, 360.0), (-3, 360.0), (0.5, None), (-0.25, None)])
def test_a_gear_ties_two_drives(ratio, period):
    plain = SATELLITE.replace(b'<mimic joint="drive" multiplier="-1" offset="0.5"/>', b"")
    data = pack_urdf(plain, {"panel.stl": panel()})
    geared = pack_urdf(
        SATELLITE.replace(b'multiplier="-1" offset="0.5"', f'multiplier="{ratio}"'.encode()), {"panel.stl": panel()}
    )
    tie = [{"name": "drive_right", "tied_to": "drive", "ratio": ratio}]
    free = placed(data, drive=40, drive_right=40 * ratio)
    for tied in (placed(data, tie, drive=40), placed(geared, drive=40)):
        for name, vertices in free.items():
            np.testing.assert_allclose(tied[name], vertices, atol=1e-12)
    joints = {joint.name: joint for joint in read_joints(geared, "urdf", load_mesh(geared, "urdf")).articulation.joints}
    drive = joints["drive"]
    assert (drive.minimum, drive.maximum, drive.period) == (-180, 180, period)
    slower = [{"name": "swing", "tied_to": "drive", "ratio": ratio}]
    articulation = read_joints(data, "urdf", load_mesh(data, "urdf"), slower).articulation
    (tied_to,) = (joint for joint in articulation.joints if joint.name == "drive")
    ends = sorted(np.rad2deg([-1.5, 1.0]) / ratio)  # of what cannot turn all the way
    assert (tied_to.minimum, tied_to.maximum) == pytest.approx((max(-180, ends[0]), min(180, ends[1])))


def archive(compression: int, **files: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as out:
        for name, body in files.items():
            out.writestr(name.replace("robot", "robot.urdf"), body)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (SATELLITE, "'panel.stl' was not uploaded"),
        (pack_urdf(SATELLITE, {"panel.stl": b"solid"}), "STL"),
        (pack_urdf(SATELLITE.replace(b"panel.stl", b"panel.fbx"), {"panel.fbx": b"x"}), "type .fbx"),
        (pack_urdf(SATELLITE.replace(b"panel.stl", b"panel.dae"), {"panel.dae": b"x"}), "COLLADA"),
        (b"<robot", "no element found|unclosed|not well-formed"),
        (b"<sdf/>", "not <robot>"),
        (b'<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "document types"),
        (SATELLITE.replace(b'child link="yoke"', b'child link="tip"'), "two joints"),
        (
            SATELLITE.replace(b'parent link="bus"/><child link="yoke"', b'parent link="left"/><child link="yoke"'),
            "circle",
        ),
        (SATELLITE.replace(b'xyz="0 0 2"', b'xyz="0 0 nan"'), "finite"),
        (SATELLITE.replace(b'xyz="0 0 2"', b'xyz="0 0 0"'), "axis is zero"),
        (SATELLITE.replace(b'link="boom"', b'link="bom"'), "is no link"),
        (archive(zipfile.ZIP_DEFLATED, robot=SATELLITE), "compressed"),
        (archive(zipfile.ZIP_STORED, robot=SATELLITE)[:-30], "archive"),
    ],
)
def test_what_is_refused(data, message):
    with pytest.raises(MeshError, match=message):
        load_mesh(data, "urdf")


def test_limits_hold_before_anything_large_is_made():
    few = MeshLimits(faces=3000, nodes=40, depth=3)
    spheres = b"<visual><geometry><sphere radius='1'/></geometry></visual>"
    with pytest.raises(MeshLimitError, match="faces"):
        read_parts(b"<robot><link name='a'>" + 3 * spheres + b"</link></robot>", "urdf", few)
    with pytest.raises(MeshLimitError, match="nodes"):
        read_parts(b"<robot><link name='a'>" + 41 * spheres + b"</link></robot>", "urdf", few)
    links = "".join(f"<link name='{k}'/>" for k in range(6))
    joints = "".join(
        f"<joint name='j{k}' type='fixed'><parent link='{k}'/><child link='{k + 1}'/></joint>" for k in range(5)
    )
    with pytest.raises(MeshLimitError, match="depth"):
        read_parts(f"<robot>{links}{joints}</robot>".encode(), "urdf", few)
