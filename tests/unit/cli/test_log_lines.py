"""What stands in the log: no tickets, no keys, whoever writes the line."""

import io
import logging

import pytest
import structlog

from service.cli import logs


@pytest.fixture(params=["json", "text"])
def written(request):
    root = logging.getLogger()
    before = root.handlers[:], root.level
    logs.configure("info", request.param)
    lines = io.StringIO()
    root.handlers[0].setStream(lines)
    yield lines.getvalue
    root.handlers[:], level = before
    root.setLevel(level)
    logging.getLogger("uvicorn.access").disabled = False
    structlog.reset_defaults()


def test_tickets_and_keys_are_left_out(written):
    address = "/v1/sessions/s/stream?after=3&ticket=Secret_1-x%7E&x=1"
    logging.getLogger("uvicorn.error").info('%s - "WebSocket %s" [accepted]', "1.2.3.4:5", address)
    logging.getLogger("websockets.server").warning("< Authorization: Bearer skypose_id_Secret")
    structlog.get_logger("ours").warning("refused", call="/v1/sessions/s/events?ticket=Secret2")
    try:
        raise ValueError(f"at {address}")
    except ValueError:
        structlog.get_logger("ours").exception("unexpected")
    text = written()
    assert "Secret" not in text
    assert "after=3&ticket=...&x=1" in text
    assert "Bearer ..." in text
    assert text.count("\n") >= 4


def test_other_lines_stay_as_they_are(written):
    structlog.get_logger("ours").info("call", path="/v1/tickets", status=201, note="tickets=3 are Bearers")
    text = written()
    assert "/v1/tickets" in text
    assert "tickets=3 are Bearers" in text
