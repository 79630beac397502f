"""What a page needs to draw a session: the frame alone, the prepared mesh, a few of many particles."""

import io

import cv2
import numpy as np
import pytest
import trimesh
from fake_worker import CUBE

from gpu.mesh import load_mesh
from service.models.mesh_glb import mesh_glb

pytestmark = pytest.mark.anyio


async def test_frame_alone_has_no_blue(api):
    session_id = await api.ready_session()
    await api.post(session_id, 0)
    here = f"/v1/sessions/{session_id}/estimates"
    answer = await api.http.get(f"{here}/0/frame.png")
    assert answer.headers["content-type"] == "image/png"
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (16, 16, 3)
    assert np.ptp(picture, axis=2).max() == 0
    assert (await api.http.get(f"{here}/1/frame.png")).status_code == 404


async def test_model_and_what_it_leaves_over_are_drawn(api):
    session_id = await api.ready_session()
    await api.post(session_id, 0)
    here = f"/v1/sessions/{session_id}/estimates"
    for name in ("model", "residual"):
        answer = await api.http.get(f"{here}/0/{name}.png")
        assert answer.headers["content-type"] == "image/png"
        assert cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR).shape == (16, 16, 3)
        assert (await api.http.get(f"{here}/1/{name}.png")).status_code == 404


async def test_mesh_is_the_prepared_one(api):
    model_id = (await api.model(CUBE)).json()["model_id"]
    answer = await api.http.get(f"/v1/models/{model_id}/mesh.glb")
    assert answer.headers["content-type"] == "model/gltf-binary"
    assert {part.name for part in load_mesh(answer.content, "glb").parts} == {"body", "wing"}
    assert (await api.http.get("/v1/models/none/mesh.glb")).status_code == 404


async def test_glb_holds_the_body_frame():
    """Read by another program: as it was prepared, the origin in the middle of the box."""
    file = io.BytesIO()
    trimesh.creation.box((4.0, 2.0, 1.0), trimesh.transformations.translation_matrix((10, 0, 0))).export(file, "stl")
    mesh = load_mesh(file.getvalue(), "stl")
    read = trimesh.load_scene(io.BytesIO(mesh_glb(mesh)), file_type="glb")
    np.testing.assert_allclose(read.bounds, [(-2, -1, -0.5), (2, 1, 0.5)], atol=1e-6)
    assert sum(len(geometry.faces) for geometry in read.geometry.values()) == mesh.n_faces


async def test_a_few_particles_stand_for_all(api):
    session_id = await api.ready_session()
    await api.post(session_id, 0)
    url = f"/v1/sessions/{session_id}/particles"
    everything, few = (await api.http.get(url)).json(), (await api.http.get(f"{url}?most=20")).json()
    assert len(everything["weights"]) == 50
    assert 1 < len(few["weights"]) <= 20
    assert abs(sum(few["weights"]) - 1) < 1e-9
    kept = [everything["orientation"].index(q) for q in few["orientation"]]
    weights = np.array(everything["weights"])[kept]
    assert np.all(np.abs(np.array(few["weights"]) - weights) < 1 / 20 + 1 / 50)
    assert (await api.http.get(f"{url}?most=50")).json() == everything
    assert (await api.http.get(f"{url}?most=0")).status_code == 422
