"""XML of clients: an entity is refused in whatever encoding it comes."""

import pytest

from gpu.collada_file import read_collada
from gpu.mesh_limits import MeshError, MeshLimits
from gpu.urdf import read_urdf

BOMB = '<!DOCTYPE robot [<!ENTITY a "{}"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"><link name="l"/></robot>'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("read", [read_urdf, read_collada])
def test_document_types_are_refused(encoding, read):
    text = BOMB.format("x" * 100)
    head = '<?xml version="1.0" encoding="UTF-16"?>' if encoding == "utf-16-be" else ""
    with pytest.raises(MeshError, match="document types and entities"):
        read((head + text).encode(encoding), MeshLimits())


@pytest.mark.parametrize("document", [b"", b"<robot", b'<?xml version="1.0" encoding="utf-99"?><robot/>', b"\xff\xfe<"])
def test_what_is_no_xml_is_refused(document):
    with pytest.raises(MeshError, match="URDF"):
        read_urdf(document, MeshLimits())


def test_a_robot_in_utf_16_is_read():
    robot = read_urdf('<robot name="r"><link name="Flügel"/></robot>'.encode("utf-16"), MeshLimits())
    assert list(robot.links) == ["Flügel"]
