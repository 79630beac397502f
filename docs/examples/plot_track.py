"""A track as a figure: angles with bands of one standard deviation, place, scale, joints, and the status in colours.

python plot_track.py SESSION --out track.png            # from a running service
python plot_track.py estimates.jsonl --out track.png    # from `skypose track`
"""

import argparse
import json
from datetime import datetime
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")  # files only: no display needed

import matplotlib.pyplot as plt
import numpy as np

from service.client import Client

COLOURS = {"tracking": "#1b7837", "acquiring": "#e08214", "lost": "#b2182b", "no_target": "#878787"}
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
PLACES = ("x_px", "y_px", "scale_px")


def load(source: str, url: str, key: str | None, smoothed: bool) -> list[dict]:
    """Estimates as documents, from a file or a session."""
    if Path(source).is_file():
        return [json.loads(line) for line in Path(source).read_text().splitlines()]
    with Client(url, api_key=key) as client:
        return [estimate.model_dump(mode="json") for estimate in client.estimates(source, smoothed=smoothed)]


def plot(estimates: list[dict], title: str) -> plt.Figure:
    """One row per quantity over time."""
    times = [datetime.fromisoformat(estimate["time"]) for estimate in estimates]
    seconds = np.array([(moment - times[0]).total_seconds() for moment in times])
    joints = list(estimates[0]["spread"]["joints"])
    figure, axes = plt.subplots(
        7 + len(joints), 1, sharex=True, layout="constrained", figsize=(10, 1.7 * (7 + len(joints)))
    )
    for axis, name in zip(axes, (*ANGLES, *PLACES), strict=False):
        values = np.array([estimate["mean"][name] for estimate in estimates])
        if name in ("yaw_deg", "roll_deg"):
            values = np.unwrap(values, period=360.0)
        band(axis, seconds, values, np.array([estimate["spread"][name] for estimate in estimates]), name)
    for axis, joint in zip(axes[6:], joints, strict=False):
        values = np.array([estimate["mean"]["joints"][joint] for estimate in estimates])
        spread = np.array([estimate["spread"]["joints"][joint] for estimate in estimates])
        band(axis, seconds, values, spread, joint)
    share = [estimate["ess"] / estimate["particles"] for estimate in estimates]
    axes[-1].plot(seconds, share, color="#4d4d4d")
    axes[-1].set(ylabel="ESS share", ylim=(0, 1), xlabel=f"seconds since {times[0]:%Y-%m-%d %H:%M:%S} UTC")
    for status, colour in COLOURS.items():
        chosen = [k for k, estimate in enumerate(estimates) if estimate["status"] == status]
        if chosen:
            axes[-1].plot(seconds[chosen], np.array(share)[chosen], "o", color=colour, markersize=3, label=status)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(title)
    return figure


def band(axis: plt.Axes, seconds: np.ndarray, values: np.ndarray, spread: np.ndarray, name: str) -> None:
    """A line and its band."""
    axis.plot(seconds, values, color="#2166ac", linewidth=1)
    axis.fill_between(seconds, values - spread, values + spread, color="#92c5de", alpha=0.6, linewidth=0)
    axis.set_ylabel(name)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", help="a session's id, or estimates.jsonl")
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--key")
    parser.add_argument("--smoothed", action="store_true", help="with all later frames taken into account")
    parser.add_argument("--out", type=Path, default=Path("track.png"))
    options = parser.parse_args()
    estimates = load(options.source, options.url, options.key, options.smoothed)
    plot(estimates, options.source).savefig(options.out, dpi=120)
    print(f"{len(estimates)} frames: {options.out}")


if __name__ == "__main__":
    main()
