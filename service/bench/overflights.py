"""The light on passes over a real site, frame by frame, as a session knows it that is told camera and orbit."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from service.attitude.camera import Site
from service.attitude.orbit import Orbit
from service.attitude.pointing import Mount, Pointing
from service.inference.light import Light
from service.inference.params import SessionConfig
from service.sessions.absolute import view_of
from service.sessions.frame import FrameTime
from service.sessions.lighting import light_at
from service.sessions.ranging import Ranged


class LitOverflight:
    """Of a ``case.json`` that says where a pass was seen from (``skypose simulate --site``)."""

    def __init__(self, described: Mapping[str, Any]) -> None:
        site = Site(*(float(described["site"][name]) for name in ("latitude_deg", "longitude_deg", "height_m")))
        self._mount = Mount(up_angle_deg=float(described["camera"]["up_angle_deg"]), site=site)
        self._orbit, self._site = Orbit(described["tle"]), site
        self._size = int(described["width"]), int(described["height"])

    def light(self, row: Mapping[str, str]) -> Light:
        """At a frame, of its line in ``pointing.csv``."""
        moment = datetime.fromisoformat(row["time"])
        pointing = Pointing(ra_deg=float(row["ra_deg"]), dec_deg=float(row["dec_deg"]))
        view = view_of(pointing, self._mount, moment, time_known=True, size=self._size)
        ranged = Ranged(self._orbit.seen_from(self._site, moment), None, None)
        return light_at(SessionConfig(), {}, FrameTime(moment, moment, 0.0), view, ranged).light
