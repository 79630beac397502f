"""A session's pointing from frame to frame: two of them make the rate at which the camera turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from service.imaging.facts import FrameFacts
from service.inference.params import CameraParams
from service.inference.state import Array
from service.sessions.absolute import (
    Aim,
    View,
    aim_of,
    camera_quaternion,
    mount_of,
    pointing_of,
    rate_since,
    view_of,
)
from service.sessions.frame import FrameIn, FrameTime
from service.store.base import SessionRecord


class Pointings:
    """Remembers the camera of the frame before."""

    def __init__(self, params: CameraParams) -> None:
        self._mount = mount_of(params)
        self._before: Array | None = None  # (4,) camera -> GCRF
        self.started = False

    def resume(self, estimate: Mapping[str, Any]) -> None:
        """Go on after a stored estimate."""
        self._before = camera_quaternion(estimate)
        self.started = True

    def view(self, record: SessionRecord, frame: FrameIn, facts: FrameFacts, moment: FrameTime) -> View | None:
        """The camera at a frame, None where it is not known. Raises ``InputError``."""
        pointing, size = pointing_of(frame.query, facts), _size(record)
        view = view_of(pointing, self._mount, moment.utc, time_known=moment.given is not None, size=size)
        if view is None or self._before is None or record.time_s is None:
            return view
        return replace(view, rate=rate_since(self._before, view.quaternion, moment.seconds - record.time_s))

    def aim(self, record: SessionRecord, frame: FrameIn, facts: FrameFacts, moment: FrameTime) -> Aim | None:
        """Where the camera looks at a frame, which needs no rotation of it; None where nobody told it."""
        return aim_of(pointing_of(frame.query, facts), self._mount, moment.utc, _size(record))

    def passed(self, view: View | None) -> None:
        """The frame is committed: it is now the one before."""
        self._before = None if view is None else view.quaternion
        self.started = True


def _size(record: SessionRecord) -> tuple[int, int]:
    """Width and height of the session's frames, px."""
    info = record.background_info or {}
    return int(info.get("width", 0)), int(info.get("height", 0))
