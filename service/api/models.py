"""Routes of models: upload, list, read, delete."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

import orjson
from fastapi import APIRouter, Request, Response
from starlette.datastructures import FormData, UploadFile

from service.access.principal import tenant_of
from service.api import schemas
from service.api.auth import OperateModel, Operator, Reader, ReadModel
from service.api.description import bytes_answered
from service.api.paging import Page, page_limit, problems, stored_page
from service.api.services import ServicesDep
from service.errors import InputError, JointError, UnsupportedMediaTypeError
from service.sessions.library import Upload
from service.sessions.near import did_you_mean

router = APIRouter(prefix="/v1/models", tags=["models"])
FILE_TYPES = ("glb", "obj", "stl", "ply", "urdf")
MAX_MESHES = 256
_MEDIA_TYPES = {
    "model/gltf-binary": "glb",
    "model/obj": "obj",
    "model/stl": "stl",
    "application/sla": "stl",
    "model/ply": "ply",
    "application/urdf+xml": "urdf",
}
_FORM: dict[str, Any] = {
    "type": "object",
    "required": ["file"],
    "additionalProperties": False,
    "properties": {
        "file": {"type": "string", "format": "binary", "description": "GLB, OBJ, STL, PLY or URDF"},
        "meshes": {
            "type": "array",
            "maxItems": MAX_MESHES,
            "items": {"type": "string", "format": "binary"},
            "description": "The mesh files that a URDF file names, by the last part of their names",
        },
        "joints": {"type": "string", "description": "JSON array; replaces the file's own, or only ties them"},
        "name": {"type": "string", "maxLength": 200},
    },
}
_UPLOAD = {"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": _FORM}}}}


@router.post(
    "",
    status_code=201,
    response_model=schemas.Model,
    responses={
        200: {"model": schemas.Model, "description": "The same content was there"},
        **problems(413, 415, 422, 503),
    },
    openapi_extra=_UPLOAD,
)
async def upload_model(request: Request, response: Response, caller: Operator, services: ServicesDep) -> dict[str, Any]:
    """Upload a spacecraft model; it is checked, repaired where that is safe, and described."""
    upload = await _read_upload(request)
    model, new = await services.library.add(caller.tenant, upload)
    if not new:
        response.status_code = 200
    response.headers["Location"] = f"/v1/models/{model['model_id']}"
    return model


@router.get("", response_model=schemas.ModelList, responses=problems(422))
async def list_models(
    caller: Reader,
    services: ServicesDep,
    query: Page,
) -> Response:
    """All models in order of upload."""
    limit = page_limit(query.limit, services.settings)
    page = await services.library.page(caller.tenant, query.after, limit)
    return stored_page("models", page.records, page.damaged, page.cursor, limit)


@router.get("/{model_id}", response_model=schemas.Model, responses=problems(404))
async def read_model(model: ReadModel, services: ServicesDep) -> dict[str, Any]:
    """One model."""
    return await services.library.get(model)


@router.get(
    "/{model_id}/mesh.glb",
    response_class=Response,
    responses={**bytes_answered("model/gltf-binary"), **problems(404, 503)},
)
async def read_mesh(model: ReadModel, services: ServicesDep) -> Response:
    """The mesh as it was prepared: body frame, joints at rest, one node per part."""
    data = await services.library.mesh(model)
    return Response(data, media_type="model/gltf-binary", headers={"Cache-Control": "private, max-age=86400"})


@router.delete("/{model_id}", status_code=204, responses=problems(404, 409))
async def delete_model(model: OperateModel, services: ServicesDep) -> None:
    """Delete a model that no session needs."""
    await services.library.remove(model)
    services.stored.forget(tenant_of(model))


async def _read_upload(request: Request) -> Upload:
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise UnsupportedMediaTypeError(
            "the body must be multipart/form-data", field="header:Content-Type", supported=["multipart/form-data"]
        )
    async with request.form(max_files=1 + MAX_MESHES, max_fields=4) as form:
        for unknown in sorted(set(form) - set(_FORM["properties"])):
            raise InputError(f"unknown field {unknown!r}{did_you_mean((), unknown, _FORM)}", field=unknown)
        file, joints, name = form.get("file"), form.get("joints"), form.get("name")
        if not isinstance(file, UploadFile):
            raise InputError("a file is required", field="file")
        if isinstance(joints, UploadFile) or isinstance(name, UploadFile):
            raise InputError("joints and name are text", field="joints")
        data = await file.read()
        file_type = _file_type(file)
        title = name or PurePath(file.filename or "model").stem
        if not data:
            raise InputError("the file is empty", field="file")
        definitions = None if joints is None else _joints(joints)
        return Upload.packed(data, file_type, title[:200], definitions, await _meshes(form))


async def _meshes(form: FormData) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for item in form.getlist("meshes"):
        name = PurePath(item.filename or "").name if isinstance(item, UploadFile) else ""
        if not isinstance(item, UploadFile) or not name:
            raise InputError("meshes are files with names", field="meshes")
        if name in found:
            raise InputError(f"two mesh files are called {name!r}", field="meshes")
        found[name] = await item.read()
    return found


def _file_type(file: UploadFile) -> str:
    suffix = PurePath(file.filename or "").suffix.lower().lstrip(".")
    file_type = suffix if suffix in FILE_TYPES else _MEDIA_TYPES.get(file.content_type or "", "")
    if not file_type:
        raise UnsupportedMediaTypeError(
            f"{file.filename!r} is none of {', '.join(FILE_TYPES)}", field="file", supported=list(FILE_TYPES)
        )
    return file_type


def _joints(text: str) -> tuple[dict[str, Any], ...]:
    try:
        data = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise JointError(f"joints is not JSON: {error}", field="joints") from error
    if not isinstance(data, list) or not all(isinstance(item, dict) for item in data):
        raise JointError("joints must be a JSON array of objects", field="joints")
    return tuple(data)
