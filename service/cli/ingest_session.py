"""The session that ``skypose ingest`` feeds: found again after a restart, or begun anew."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from service.api.schemas import Session
from service.cli.options import choose_joints
from service.client import Client, RefusedError
from service.remote.media import in_order, media_type_of

NOTE = ".skypose-ingest.json"


@dataclass(frozen=True)
class SessionPlan:
    """What a new session is made of."""

    mesh: Path | None
    background: Path | None = None
    box: str | None = None
    border: float | None = None
    joints: tuple[Mapping[str, Any], ...] | None = None
    config: Mapping[str, Any] = field(default_factory=dict)
    name: str | None = None


def read_config(path: Path | None) -> dict[str, Any]:
    """Sections of a session's configuration from a JSON file. Raises ``typer.BadParameter``."""
    if path is None:
        return {}
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"--config: {error}") from error
    if not isinstance(value, dict):
        raise typer.BadParameter('--config must hold a JSON object, such as {"filter": {"seed": 1}}')
    return value


def remembered_session(client: Client, note: Path) -> str | None:
    """The session of an earlier run on this folder, if the service still has it. Raises ``typer.BadParameter``."""
    if not note.is_file():
        return None
    try:
        session_id = str(json.loads(note.read_text())["session_id"])
    except (ValueError, KeyError, TypeError) as error:
        raise typer.BadParameter(f"{note} names no session; remove it, or give --session") from error
    try:
        return client.session(session_id).session_id
    except RefusedError as error:
        if error.status != 404:
            raise
        return None


def remember_session(note: Path, session_id: str) -> None:
    """Written once the session can take frames. Raises ``typer.BadParameter`` where it cannot be."""
    try:
        note.write_text(json.dumps({"session_id": session_id}) + "\n")
    except OSError as error:
        raise typer.BadParameter(f"cannot remember session {session_id}: {error}; give another --note") from error


def begin_session(client: Client, plan: SessionPlan, first_frame: Path) -> Session:
    """Upload the model, create the session, teach it the sky. Raises ``typer.BadParameter``, ``ClientError``.

    All joints of a model with a few are estimated, of one with many none, unless the plan says otherwise.
    """
    if plan.mesh is None:
        raise typer.BadParameter("give --session, or --mesh for a new one")
    told = sum(one is not None for one in (plan.background, plan.box, plan.border))
    if told > 1:
        raise typer.BadParameter("give one of --background, --box, --border")
    model = client.upload_model(plan.mesh, joints=plan.joints)
    free = choose_joints(None, tuple(joint.name for joint in model.joints))
    sections: dict[str, Any] = {"joints": {"free": list(free)}, **plan.config}
    if not told:
        sections["background"] = "auto"
    session = client.create_session(model.model_id, name=plan.name, **sections)
    session_id = session.session_id
    if plan.background is not None:
        for path in background_files(plan.background):
            client.add_background(session_id, path)
    elif plan.box is not None:
        client.add_background(session_id, first_frame, box=plan.box)
    elif plan.border is not None:
        client.add_background(session_id, first_frame, border=plan.border)
    return session.model_copy(update={"warnings": [*model.warnings, *session.warnings]})


def background_files(source: Path) -> list[Path]:
    """A file, or a folder's images. Raises ``typer.BadParameter`` where there is none."""
    files = in_order(source.iterdir()) if source.is_dir() else [source]
    known = [path for path in files if path.is_file() and media_type_of(path.name) is not None]
    if not known:
        raise typer.BadParameter(f"--background: {source} holds no image")
    return known
