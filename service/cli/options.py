"""Option values that several commands read."""

from __future__ import annotations

import typer


def parse_size(text: str) -> tuple[int, int]:
    """``320x240`` -> (width, height)."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()) or not (16 <= int(width) <= 8192 and 16 <= int(height) <= 8192):
        raise typer.BadParameter(f"{text!r} is no size such as 320x240, 16 to 8192 pixels a side")
    return int(width), int(height)


def parse_box(text: str) -> tuple[float, float, float, float]:
    """``x,y,w,h`` in pixels -> numbers."""
    try:
        x, y, w, h = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is no box x,y,w,h in pixels") from error
    if w <= 0 or h <= 0:
        raise typer.BadParameter(f"the box {text!r} has no area")
    return x, y, w, h


def choose_joints(text: str | None, names: tuple[str, ...]) -> tuple[str, ...]:
    """``all``, ``none`` or ``A,B`` -> names; without a choice all of a few joints, none of many."""
    if text is None:
        return names if len(names) <= FEW_JOINTS else ()
    if text == "all":
        return names
    if text == "none":
        return ()
    chosen = tuple(part.strip() for part in text.split(","))
    for name in chosen:
        if name not in names:
            raise typer.BadParameter(f"the model has no joint {name!r}; it has {', '.join(names) or 'none'}")
    return chosen


FEW_JOINTS = 3
