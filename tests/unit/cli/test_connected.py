"""Commands that talk to a service, where none is."""

import socket

from typer.testing import CliRunner

from service.cli import app


def test_where_no_service_is_one_line_says_what_to_do_at_once(monkeypatch) -> None:
    monkeypatch.setattr("service.client.Client", None)  # which would wait for a service that starts again
    with socket.socket() as taken:  # bound, but nobody listens
        taken.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        told = CliRunner().invoke(app, ["sessions", "list", "--url", url])
    assert told.exit_code == 1 and told.output.count("\n") == 1
    assert told.output.startswith(f"{url}: no service answers") and "skypose serve" in told.output
