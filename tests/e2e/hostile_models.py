"""Models made to cost, and what a stranger's overlay waits for meanwhile.

    python tests/e2e/hostile_models.py [--kinds nodes joints faces "most nodes" ...] [--at-once 3]

A tenant uploads each file several times at once; another, with a session of its own, asks for an overlay again and
again. Prints per file what the uploads were answered and took, and the longest wait of the other's overlays.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import numpy as np
from passes import PNG, begin, box_pass
from server_process import ROOT, Server

sys.path.append(str(ROOT))
from service.simulate.glb_writer import _container

BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], "<f4")
FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
FACES += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


def glb(count: int, articulated: bool = False) -> bytes:
    """One box, shown by so many nodes, each with a joint or none."""
    places = np.random.default_rng(1).uniform(-20, 20, (count, 3)).round(2).tolist()
    nodes = [{"mesh": 0, "translation": place} for place in places]
    stage = {"name": "s", "type": "xRotate", "minimumValue": -180, "maximumValue": 180, "initialValue": 0}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(count))}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": [-0.5] * 3, "max": [0.5] * 3},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 96}, {"buffer": 0, "byteOffset": 96, "byteLength": 72}],
        "buffers": [{"byteLength": 168}],
    }
    if articulated:
        for k, node in enumerate(nodes):
            node["extensions"] = {"AGI_articulations": {"articulationName": f"a{k}"}}
        moving = [{"name": f"a{k}", "stages": [stage]} for k in range(count)]
        tree["extensions"] = {"AGI_articulations": {"articulations": moving}}
    return _container(tree, BOX.tobytes() + np.array(FACES, "<u2").tobytes())


def soup(count: int, size: float) -> bytes:
    """A binary STL of so many random faces."""
    rng = np.random.default_rng(1)
    faces = np.zeros(count, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    faces["corners"] = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return bytes(80) + count.to_bytes(4, "little") + faces.tobytes()


KINDS: dict[str, Callable[[], tuple[str, bytes]]] = {
    "nodes": lambda: ("x.glb", glb(9_999)),
    "joints": lambda: ("x.glb", glb(3_000, articulated=True)),
    "faces": lambda: ("x.stl", soup(990_000, 1.0)),
    "most nodes": lambda: ("x.glb", glb(512)),
    "most joints": lambda: ("x.glb", glb(64, articulated=True)),
    "most faces": lambda: ("x.stl", soup(990_000, 0.01)),
}


def key(data: Path, tenant: str) -> dict[str, str]:
    """The header of a new key."""
    command = [sys.executable, "-m", "service", "keys", "create", "--role", "operate", "--tenant", tenant]
    made = subprocess.run(
        [*command, "--name", "x", "--data", data], cwd=ROOT, check=True, capture_output=True, text=True
    )
    text = next(word for word in made.stdout.split() if word.startswith("skypose_"))
    return {"Authorization": f"Bearer {text}"}


def upload(url: str, headers: dict[str, str], name: str, body: bytes) -> tuple[int, float, str]:
    """Status, seconds, and what was said."""
    began = time.monotonic()
    answer = httpx.post(f"{url}/v1/models", headers=headers, files={"file": (name, body)}, timeout=900)
    found = answer.json()
    return answer.status_code, time.monotonic() - began, found.get("detail") or f"{len(found['warnings'])} warnings"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--at-once", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        hostile, good = key(data, "hostile"), key(data, "good")
        server = Server(data, auth="required", log_level="warning")
        server.start()
        try:
            with httpx.Client(base_url=server.url, headers=good, timeout=900) as http:
                seen = box_pass(1)
                session = begin(http, seen, filter={"particles": 200})
                http.post(f"/v1/sessions/{session}/frames", content=seen.frames[0], headers=PNG).raise_for_status()
                for kind in given.kinds:
                    print(json.dumps(attack(server.url, hostile, http, session, kind, given.at_once)), flush=True)
        finally:
            server.stop()


def attack(
    url: str, hostile: dict[str, str], http: httpx.Client, session: str, kind: str, at_once: int
) -> dict[str, object]:
    """One file, several times at once."""
    name, body = KINDS[kind]()
    waits = []
    with ThreadPoolExecutor(at_once) as pool:
        uploads = [pool.submit(upload, url, hostile, name, body) for _ in range(at_once)]
        while not all(one.done() for one in uploads):
            began = time.monotonic()
            http.get(f"/v1/sessions/{session}/estimates/0/overlay.png").raise_for_status()
            waits.append(time.monotonic() - began)
        found = [one.result() for one in uploads]
    return {
        "kind": kind,
        "file_kib": len(body) >> 10,
        "status": [status for status, _, _ in found],
        "seconds": [round(seconds, 1) for _, seconds, _ in found],
        "said": found[0][2][:100],
        "overlays": len(waits),
        "longest_wait_s": round(max(waits, default=0.0), 2),
    }


if __name__ == "__main__":
    main()
