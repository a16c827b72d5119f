"""The command ``bench``."""

import pytest
from boards_table import read_figures
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.workbench.board_figures import (
    SCHEMA_VERSION,
    DetectorSpeed,
    Figures,
    Heat,
    Latency,
    OwnRun,
    Times,
    this_computer,
)

SIZES = ((640, 480), (1280, 720), (1920, 1080))
TIMES = Times(median_ms=2.0, p95_ms=3.0, mean_ms=2.1)
FIGURES = Figures(
    schema_version=SCHEMA_VERSION,
    note="",
    computer=this_computer(),
    before=Heat(temperature_c=None, throttled=None),
    after=Heat(temperature_c=None, throttled=None),
    run=OwnRun(first_command_s=1.5, peak_memory_mb=82.0),
    latency=Latency(frames=100, p50_ms=1.0, p95_ms=2.0, p99_ms=3.0),
    detectors=tuple(
        DetectorSpeed(detector=name, width_px=size[0], height_px=size[1], search=TIMES, track=TIMES, found=1.0)
        for size in SIZES
        for name in ("ball", "sheet", "tag", "disc")
    ),
)
"""Figures to print. How they are measured is tested beside the code, and with the command in the long tests."""


@pytest.fixture
def shown(monkeypatch):
    monkeypatch.setattr("stadimeter.cli.bench.measure", lambda *_arguments, **_options: FIGURES)
    return CliRunner().invoke(app, ["bench", "--seconds", "0.3"])


def test_it_prints_a_line_for_each_detector_and_size(shown):
    assert shown.exit_code == 0
    for size in ("640x480", "1280x720", "1920x1080"):
        for detector in ("ball", "sheet", "tag", "disc"):
            assert any(detector in line and size in line for line in shown.output.splitlines()), (detector, size)


def test_it_names_the_computer_and_tells_latency_and_memory(shown):
    assert "OpenCV threads" in shown.output
    assert "stadimeter 0" in shown.output
    assert "Latency from frame to actuator: median " in shown.output
    assert "A run of the program: first command " in shown.output


@pytest.mark.long
def test_json_is_the_file_to_send_with_its_note(tmp_path):
    result = CliRunner().invoke(app, ["bench", "--seconds", "0.3", "--note", "in a drawer", "--json"])
    assert result.exit_code == 0
    (tmp_path / "board.json").write_text(result.stdout)
    figures = read_figures(tmp_path / "board.json")
    assert figures.note == "in a drawer"
    assert len(figures.detectors) == 12
    assert figures.latency.p50_ms <= figures.latency.p99_ms


def test_no_time_at_all_is_refused():
    assert CliRunner().invoke(app, ["bench", "--seconds", "0"]).exit_code == 2
