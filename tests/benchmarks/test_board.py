"""The figures of a computer, and the file in which they are sent."""

from __future__ import annotations

import getpass
import json
import platform
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from boards_table import read_figures
from msgspec.structs import astuple

from stadimeter.errors import UnreadableError
from support.command_line import typed

BOARD = Path(__file__).with_name("board.py")


@pytest.mark.long
def test_every_detector_finds_what_it_is_measured_on_and_the_file_can_be_sent(tmp_path: Path) -> None:
    from board import exercises

    sent = tmp_path / "board.json"
    told = ["--seconds", "0.3", "--note", "in a drawer", "--out", str(sent)]
    subprocess.run([sys.executable, str(BOARD), *told], check=True, timeout=300)
    written = sent.read_text(encoding="utf-8")
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
        sent.write_text(json.dumps(json.loads(written) | change))
        with pytest.raises(UnreadableError):
            read_figures(sent)


def test_the_command_that_is_gone_says_what_to_do() -> None:
    done = typed("bench")
    assert done.returncode == 2
    assert "there is no command 'bench' any more: `stadimeter doctor` says how fast this board is" in " ".join(
        done.stderr.split()
    )
