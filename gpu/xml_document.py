"""XML of clients: no document types and no entities, in whatever encoding."""

from __future__ import annotations

from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from gpu.mesh_limits import MeshError


def read_xml(data: bytes, what: str) -> Element:
    """The root element. Raises ``MeshError`` that begins with ``what`` was to be read."""
    try:
        root: Element = fromstring(data, forbid_dtd=True)
    except DefusedXmlException as error:
        raise MeshError(f"{what}: document types and entities are not read") from error
    except (
        ParseError,
        LookupError,
        ValueError,
    ) as error:  # or of an encoding that is none
        raise MeshError(f"{what}: {error}") from error
    return root
