"""The bill of materials: valid CycloneDX, everything in it, the same bytes twice."""

import json
import re
import shutil
import subprocess
import sys
from importlib.metadata import version
from importlib.resources import files

import jsonschema
import pytest
from referencing import Registry, Resource


@pytest.fixture(scope="module")
def text(root):
    made = subprocess.run([sys.executable, root / "deploy" / "sbom"], check=True, capture_output=True, text=True)
    return made.stdout


def test_is_valid_cyclonedx(text):
    pytest.importorskip("cyclonedx")
    folder = files("cyclonedx.schema") / "_res"
    schemas = {
        name: json.loads((folder / f"{name}.SNAPSHOT.schema.json").read_text())
        for name in ("bom-1.6", "spdx", "jsf-0.82")
    }
    registry = Registry().with_resources((schema["$id"], Resource.from_contents(schema)) for schema in schemas.values())
    jsonschema.Draft7Validator(schemas["bom-1.6"], registry=registry).validate(json.loads(text))


def test_holds_every_package(text):
    document = json.loads(text)
    held = {component["purl"] for component in document["components"]}
    for name in ("numpy", "fastapi", "pyopencl"):
        assert f"pkg:pypi/{name}@{version(name)}" in held
    assert document["metadata"]["component"]["purl"] == f"pkg:pypi/skypose@{version('skypose')}"
    assert len(held) == len(document["components"])
    if shutil.which("dpkg-query"):
        libc = next(component for component in document["components"] if component["name"] == "libc6")
        assert re.fullmatch(r"pkg:deb/debian/libc6@[^?]+\?arch=\w+", libc["purl"])
        assert libc["properties"][0]["value"].startswith("glibc ")


def test_the_same_packages_give_the_same_bytes(root, text, tmp_path):
    out = tmp_path / "sbom.json"
    subprocess.run([sys.executable, root / "deploy" / "sbom", "--out", out], check=True)
    assert out.read_text() == text
