"""How fast a pose changes, on the wire."""

from __future__ import annotations

from service.api.wire import Wire


class AxisRates(Wire):
    """About the body's axes."""

    x: float
    y: float
    z: float


class JointRate(Wire):
    """Degrees (revolute) or model units (prismatic) per second."""

    rate_per_s: float
    spread_per_s: float


class Rates(Wire):
    """How fast the pose changes against the camera, in the mode of `best`; spreads are standard deviations."""

    angular_velocity_deg_s: AxisRates
    spread_deg_s: AxisRates
    joints: dict[str, JointRate]
