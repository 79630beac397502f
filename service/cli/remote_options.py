"""Options of the commands that talk to a running service."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.client import Client

DEFAULT_URL = "http://127.0.0.1:8000"
Url = Annotated[str, typer.Option(envvar="SKYPOSE_URL", help="Address of the service.")]
Key = Annotated[str | None, typer.Option(envvar="SKYPOSE_API_KEY", help="API key, where the service asks for one.")]


@contextmanager
def connected(url: str, key: str | None, *, patient: bool = False) -> Iterator[Client]:
    """A client of the service. What it warns of is told in a line; what goes wrong too, with exit status 1.

    ``patient``: a service that does not answer at first may still be starting. Else nobody waits for one that is not
    there; once it has answered, a restart is waited for.
    """
    import warnings

    import httpx

    from service.client import Client, ClientError

    try:
        if not patient:
            with suppress(httpx.TimeoutException):  # one that is slow is there
                httpx.get(f"{url.rstrip('/')}/healthz")
        with warnings.catch_warnings(), Client(url, api_key=key) as client:
            warnings.showwarning = lambda message, *_: typer.secho(f"{url}: {message}", fg="yellow", err=True)
            yield client
    except httpx.ConnectError as error:
        typer.secho(
            f"{url}: no service answers ({error}). skypose serve starts one; --url names another.", fg="red", err=True
        )
        raise typer.Exit(1) from error
    except (ClientError, httpx.TransportError) as error:
        typer.secho(f"{url}: {str(error) or type(error).__name__}", fg="red", err=True)
        raise typer.Exit(1) from error
