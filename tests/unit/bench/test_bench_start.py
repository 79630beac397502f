"""What ``skypose bench start`` reads of processes, and what it makes of it."""

import subprocess
import sys

from service.bench.start import Memory, Start, computed_s, memory_of, start_document, start_tables

PARENT = (
    "import subprocess, sys; c = subprocess.Popen([sys.executable, '-c', sys.argv[1]], stdin=0); print(c.pid); c.wait()"
)
DECODER = "import sys; sys.argv.append('service.workers.decode_child'); print(len(bytearray(8 << 20))); input()"


def test_memory_is_told_of_every_process_by_what_it_does():
    with subprocess.Popen(
        [sys.executable, "-uc", PARENT, DECODER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as service:
        service.stdout.readline(), service.stdout.readline()  # both are up
        found = memory_of(service.pid)
        assert computed_s(service.pid) > 0
        service.communicate("\n")
    assert [row.process for row in found] == ["web", "decoder"]
    assert all(0 < row.private_mb <= row.pss_mb < 1000 for row in found)


def test_the_document_has_every_start_and_their_medians():
    starts = [Start(900.0, 1500.0), Start(2000.04, 1700.0), Start(1000.0, 1400.0)]
    document = start_document({"cpu": "x"}, starts, [Memory("web", 80.04, 70.0), Memory("decoder", 50.0, 40.0)])
    assert document["rows"][1] == {"ready_ms": 2000.0, "cpu_ms": 1700.0}
    assert document["median"] == {"ready_ms": 1000, "cpu_ms": 1500}
    assert (document["pss_mb"], document["absent"]) == (130.0, {})
    assert len(start_tables(document)) == 2


def test_memory_that_may_not_be_seen_is_said_to_be_absent():
    document = start_document({}, [Start(1.0, 1.0)], [])
    assert document["pss_mb"] is None
    assert "memory" in document["absent"]
    assert len(start_tables(document)) == 1
