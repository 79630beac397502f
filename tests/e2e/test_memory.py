"""The bounds of memory: as the document states them, and found for every kind of process."""

import httpx
import pytest
from memory import BOUNDS_MB, over_bound, peaks_mb
from passes import PNG, begin, box_pass
from server_process import Server


def test_the_document_states_the_bounds(root):
    section = (root / "docs" / "operations.md").read_text().partition("## Memory")[2].partition("\n## ")[0]
    for name, bound in BOUNDS_MB.items():
        assert f"{name}: {bound} MiB" in section.replace("**", ""), name


@pytest.mark.long
def test_every_kind_of_process_is_looked_at_and_stays_within(tmp_path):
    server = Server(tmp_path / "data", log_level="error")
    server.start()
    try:
        with httpx.Client(base_url=server.url, timeout=120) as http:
            given = box_pass(2)
            session = begin(http, given, filter={"particles": 50}, light={"sun": [0.0, 0.0, -1.0]})
            for frame in given.frames:
                http.post(f"/v1/sessions/{session}/frames", content=frame, headers=PNG).raise_for_status()
        peaks = peaks_mb(server.pid)
        assert peaks.keys() == BOUNDS_MB.keys()
        assert min(peaks.values()) > 10
        assert over_bound(peaks) == []
        assert over_bound({"web": 10**6, "worker": 1}) == ["web"]
    finally:
        server.stop()
