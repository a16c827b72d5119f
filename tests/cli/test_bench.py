"""The command ``bench``, and the file in which the figures of a computer are sent."""

from __future__ import annotations

import getpass
import json
import platform
import socket
from pathlib import Path

import pytest
from boards_table import read_figures
from msgspec.structs import astuple

from stadimeter.errors import UnreadableError
from stadimeter.workbench.bench import exercises
from support.command_line import typed


@pytest.mark.long
def test_every_detector_finds_what_it_is_measured_on_and_the_file_can_be_sent(tmp_path: Path) -> None:
    done = typed("bench", "--seconds", "0.3", "--note", "in a drawer", "--json")
    assert done.returncode == 0, done.stderr
    sent = tmp_path / "board.json"
    sent.write_text(done.stdout)
    figures = read_figures(sent)
    assert figures.note == "in a drawer"
    assert {(speed.detector, speed.width_px, speed.found) for speed in figures.detectors} == {
        (name, width, 1.0) for name in exercises() for width in (640, 1280, 1920)
    }
    assert 0 < figures.latency.p50_ms <= figures.latency.p95_ms <= figures.latency.p99_ms
    assert 40 < figures.run.peak_memory_mb < 4000
    words = {word for value in astuple(figures.computer) for word in str(value).split()}
    assert not words & {socket.gethostname(), platform.node(), getpass.getuser()}, "nobody is named"
    for change in ({"schema_version": 1}, {"host": "kitchen"}, {"detectors": []}):
        sent.write_text(json.dumps(json.loads(done.stdout) | change))
        with pytest.raises(UnreadableError):
            read_figures(sent)


def test_no_time_at_all_is_refused() -> None:
    assert typed("bench", "--seconds", "0").returncode == 2
