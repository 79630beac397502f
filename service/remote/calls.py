"""Every call of the API as data: what is sent, whether it may be sent twice, and how its answer is read."""

from __future__ import annotations

import io
import uuid
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx
import numpy as np
import orjson
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from service.api import schemas
from service.api.object_schemas import ObjectMotion, TrackedObject
from service.remote.errors import RefusedError, UnexpectedError
from service.remote.media import media_type_of
from service.remote.urdf_files import mesh_files

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)
Image = bytes | Path
"""A file's bytes, or the path of a file."""
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request and how to read its answer."""

    method: str
    path: str
    read: Callable[[httpx.Response], T]
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    content: bytes | None = None
    files: Sequence[tuple[str, tuple[str, bytes]]] | None = None
    form: Mapping[str, str] | None = None
    repeatable: bool = True
    """Whether it may be sent again when nobody knows what became of it."""
    when_gone: Callable[[], T] | None = None
    """The answer where a repeated call finds nothing: the first one did its work."""
    when_missing: Callable[[], T] | None = None
    """The answer where any call finds nothing."""

    def request(self, http: httpx.Client | httpx.AsyncClient) -> httpx.Request:
        """Built anew for every attempt."""
        return http.build_request(
            self.method,
            self.path,
            params={name: value for name, value in self.params.items() if value is not None} or None,
            headers=dict(self.headers),
            content=self.content,
            files=self.files,
            data=self.form,
        )

    def refused(self, error: RefusedError, failures: int) -> T:
        """The answer for a refusal after so many failed attempts. Raises ``error`` where there is none."""
        otherwise = self.when_missing or (self.when_gone if failures else None)
        if otherwise is None or error.status != httpx.codes.NOT_FOUND:
            raise error
        return otherwise()


def parsed(kind: type[M], data: Any) -> M:
    """A document of the wire. Members of a newer service are passed over. Raises ``UnexpectedError``."""
    try:
        return kind.model_validate(data, extra="ignore")
    except ValidationError as error:
        raise UnexpectedError(f"the answer is no {kind.__name__}: {error}") from error


def _json(kind: type[M]) -> Callable[[httpx.Response], M]:
    return lambda response: parsed(kind, response.json())


def _bytes(response: httpx.Response) -> bytes:
    return response.content


def _nothing(response: httpx.Response) -> None:
    return None


def _npz(response: httpx.Response) -> Arrays:
    with np.load(io.BytesIO(response.content)) as arrays:
        return dict(arrays)


def read_image(image: Image, media_type: str | None) -> tuple[bytes, str]:
    """Bytes and media type. Raises ``ValueError`` where the type is neither given nor told by the file's name."""
    kind = media_type or (media_type_of(image.name) if isinstance(image, Path) else None)
    if kind is None:
        raise ValueError("give the media_type: the name does not tell it")
    return (image.read_bytes() if isinstance(image, Path) else image), kind


def upload_model(
    file: Image,
    name: str | None,
    file_name: str | None,
    joints: Sequence[Mapping[str, Any]] | None,
    meshes: Sequence[Path] | None,
) -> Call[schemas.Model]:
    """Repeatable: a model is known by its content."""
    data = file.read_bytes() if isinstance(file, Path) else file
    title = file_name or (file.name if isinstance(file, Path) else None)
    if title is None:
        raise ValueError("give the file_name: its suffix tells the format")
    form = {} if name is None else {"name": name}
    if joints is not None:
        form["joints"] = orjson.dumps(list(joints)).decode()
    if meshes is None:
        meshes = mesh_files(file) if isinstance(file, Path) and file.suffix.lower() == ".urdf" else ()
    files = [("file", (title, data)), *(("meshes", (path.name, path.read_bytes())) for path in meshes)]
    return Call("POST", "/v1/models", _json(schemas.Model), files=files, form=form)


def create_session(body: Mapping[str, Any]) -> Call[schemas.Session]:
    """Not repeatable: it would begin a second session."""
    head = {"Content-Type": "application/json"}
    content = orjson.dumps({name: value for name, value in body.items() if value is not None})
    return Call("POST", "/v1/sessions", _json(schemas.Session), content=content, headers=head, repeatable=False)


def create_object(name: str, sessions: Sequence[str]) -> Call[TrackedObject]:
    """Not repeatable: it would name a second object."""
    head = {"Content-Type": "application/json"}
    content = orjson.dumps({"name": name, "sessions": list(sessions)})
    return Call("POST", "/v1/objects", _json(TrackedObject), content=content, headers=head, repeatable=False)


def join_object(object_id: str, session_id: str) -> Call[TrackedObject]:
    """A session is of an object."""
    return Call("PUT", f"/v1/objects/{object_id}/sessions/{session_id}", _json(TrackedObject))


def object_motion(object_id: str, number: int | None) -> Call[ObjectMotion]:
    """How an object turned in a pass."""
    return get(ObjectMotion, f"/v1/objects/{object_id}/motion", **{"pass": number})


def get(kind: type[M], path: str, **params: Any) -> Call[M]:
    """A document of the wire."""
    return Call("GET", path, _json(kind), params)


P = TypeVar("P", schemas.ModelList, schemas.SessionList, schemas.EstimateList)


def page(kind: type[P], url: str, params: Mapping[str, Any]) -> Call[P]:
    """A page of a list; its ``next`` is the next one's ``url``, without ``params``. Warns of what is left out of it."""

    def parse(response: httpx.Response) -> P:
        found = _json(kind)(response)
        if left_out := getattr(found, "damaged", []):  # estimates have none: there it is an error
            warnings.warn(f"left out, for what is stored of them is damaged: {', '.join(left_out)}", stacklevel=4)
        return found

    return Call("GET", url, parse, params)


def get_bytes(path: str, **params: Any) -> Call[bytes]:
    """A file."""
    return Call("GET", path, _bytes, params)


def export(session_id: str, file_format: str, smoothed: bool | None, options: Mapping[str, str]) -> Call[bytes]:
    """The attitude history as a file."""
    path = f"/v1/sessions/{session_id}/export"
    asked = None if smoothed is None else str(smoothed).lower()
    return get_bytes(path, format=file_format, smoothed=asked, **options)


def frame_by_key(session_id: str, key: str) -> Call[schemas.Estimate | None]:
    """What became of a frame; under way counts as not there."""
    read = _json(schemas.Estimate)
    return Call(
        "GET",
        f"/v1/sessions/{session_id}/frames/by-key/{quote(key, safe='')}",
        lambda response: None if response.status_code == httpx.codes.ACCEPTED else read(response),
        when_missing=lambda: None,
    )


def get_particles(session_id: str, index: int | None) -> Call[Arrays]:
    """Arrays of the weighted particles."""
    path = f"/v1/sessions/{session_id}/particles"
    return Call("GET", path, _npz, {"index": index}, {"Accept": "application/x-npz"})


def delete(path: str) -> Call[None]:
    """Repeatable: what is gone when it is sent again was deleted by the first."""
    return Call("DELETE", path, _nothing, when_gone=lambda: None)


def put_checkpoint(session_id: str, blob: bytes) -> Call[schemas.Session]:
    """A session from another service."""
    head = {"Content-Type": "application/octet-stream"}
    return Call("PUT", f"/v1/sessions/{session_id}/checkpoint", _json(schemas.Session), content=blob, headers=head)


def add_background(
    session_id: str, image: Image, media_type: str | None, params: Mapping[str, Any]
) -> Call[schemas.BackgroundResult]:
    """Repeatable by its key."""
    body, kind = read_image(image, media_type)
    head = {"Content-Type": kind, "Idempotency-Key": str(uuid.uuid4())}
    path = f"/v1/sessions/{session_id}/background"
    return Call("POST", path, _json(schemas.BackgroundResult), params, head, body)


def frame(
    session_id: str,
    image: Image,
    media_type: str | None,
    index: int | None,
    key: str | None,
    params: Mapping[str, Any],
) -> Call[schemas.Estimate]:
    """Repeatable by its index, or else by its key; without either a key is drawn."""
    body, kind = read_image(image, media_type)
    head = {"Content-Type": kind}
    path = f"/v1/sessions/{session_id}/frames"
    if index is None or key is not None:
        head["Idempotency-Key"] = key or str(uuid.uuid4())
    method, path = ("POST", path) if index is None else ("PUT", f"{path}/{index}")
    query = {name: value.isoformat() if isinstance(value, datetime) else value for name, value in params.items()}
    return Call(method, path, _json(schemas.Estimate), query, head, body)
