"""Whether plots can be drawn at all."""

from __future__ import annotations


class PlotsMissingError(RuntimeError):
    """matplotlib is not installed."""


def require_matplotlib() -> None:
    """Raises ``PlotsMissingError`` before an hour of benchmark is spent on a report that cannot be drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise PlotsMissingError("plots need matplotlib: .venv/bin/pip install matplotlib") from error
