"""``skypose plot``: a session's posterior and residuals as figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected


def plot(
    session: Annotated[str, typer.Argument(help="The session's id.")],
    out: Annotated[Path, typer.Option(help="Folder for the figures.")],
    index: Annotated[int | None, typer.Option(min=0, help="Frame of the posterior; the newest by default.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Draw orientation.png, corner.png (the particles of a frame) and residuals.png (filtered against smoothed)."""
    from service.bench.plotting import PlotsMissingError, require_matplotlib

    try:
        require_matplotlib()
    except PlotsMissingError as error:
        typer.secho(str(error), fg="red", err=True)
        raise typer.Exit(1) from error
    from service.cli.figures import corner_figure, orientation_figure, residual_figure

    with connected(url, key) as client:
        estimate = client.estimate(session, index)
        particles = client.particles(session, estimate.index)
        told = client.session(session)
        models = [client.model(one) for one in [told.model_id, *(told.model_ids or ())] if one is not None]
        filtered, smoothed = list(client.estimates(session)), list(client.estimates(session, smoothed=True))
    out.mkdir(parents=True, exist_ok=True)
    figures = {
        "orientation.png": orientation_figure(estimate, particles),
        "corner.png": corner_figure(estimate, particles, [joint for model in models for joint in model.joints]),
        "residuals.png": residual_figure(filtered, smoothed),
    }
    for name, figure in figures.items():
        figure.savefig(out / name, dpi=120)
        typer.echo(out / name)
