"""What is known of a frame before it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

from service.inference.held import Held
from service.sessions.absolute import Aim, View
from service.sessions.frame import FrameTime
from service.sessions.lighting import Lit
from service.sessions.ranging import Ranged


@dataclass(frozen=True)
class Known:
    """Its time, the camera and where it looks, the object's range, the light, and how the object is held."""

    moment: FrameTime
    view: View | None
    aim: Aim | None
    ranged: Ranged | None
    lit: Lit
    held: Held | None
