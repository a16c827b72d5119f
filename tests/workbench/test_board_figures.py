"""The file in which the figures of a computer are sent."""

import getpass
import json
import platform
import socket
from pathlib import Path

import pytest
from boards_table import read_figures
from msgspec.structs import astuple

from stadimeter.errors import UnreadableError
from stadimeter.workbench.board_figures import (
    SCHEMA_VERSION,
    DetectorSpeed,
    Figures,
    Heat,
    Latency,
    OwnRun,
    Times,
    processor_limit,
    this_computer,
    to_json,
)

TIMES = Times(median_ms=2.0, p95_ms=3.0, mean_ms=2.1)
SHEET = DetectorSpeed(detector="sheet", width_px=640, height_px=480, search=TIMES, track=None, found=0.0)


@pytest.fixture(scope="module")
def figures():
    return Figures(
        schema_version=SCHEMA_VERSION,
        note="small heat sink",
        computer=this_computer(),
        before=Heat(temperature_c=41.3, throttled="0x0"),
        after=Heat(temperature_c=None, throttled=None),
        run=OwnRun(first_command_s=1.5, peak_memory_mb=82.0),
        latency=Latency(frames=100, p50_ms=1.0, p95_ms=2.0, p99_ms=3.0),
        detectors=(SHEET,),
    )


def test_what_is_written_is_read_again(figures, tmp_path):
    file = tmp_path / "board.json"
    file.write_text(to_json(figures))
    assert read_figures(file) == figures


def test_nobody_is_named(figures):
    words = {word for value in astuple(figures.computer) for word in str(value).split()}
    assert not words & {socket.gethostname(), platform.node(), getpass.getuser()}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema_version": 1}, "`$.schema_version`"),
        (
            {"run": {"first_command_s": "soon", "peak_memory_mb": 80}},
            "`str` - at `$.run.first_command_s`",
        ),
        ({"host": "kitchen"}, "unknown field `host`"),
        ({"detectors": []}, "length >= 1 - at `$.detectors`"),
        ({"before": {"temperature_c": None, "throttled": "<b>"}}, "`$.before.throttled`"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(figures, tmp_path, change, said):
    file = tmp_path / "board.json"
    file.write_text(json.dumps(json.loads(to_json(figures)) | change))
    with pytest.raises(UnreadableError) as refused:
        read_figures(file)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\0", '{"schema_version": 2}'])
def test_text_that_is_no_such_file_is_refused_in_one_line(tmp_path, text):
    file = tmp_path / "board.json"
    file.write_text(text)
    with pytest.raises(UnreadableError) as refused:
        read_figures(file)
    assert "\n" not in str(refused.value)


def test_times_are_those_of_the_samples():
    assert astuple(Times.of([n / 1000 for n in range(1, 101)])) == pytest.approx((50.5, 95.0, 50.5))
    assert Times.of([0.004]) == Times(median_ms=4.0, p95_ms=4.0, mean_ms=4.0)


def test_the_limit_of_a_control_group_is_found_above_the_innermost_too(tmp_path):
    lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    group = next((line.removeprefix("0::/") for line in lines if line.startswith("0::")), None)
    if group is None:
        pytest.skip("no control groups of version 2 on this computer")
    folder = tmp_path / group
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cpu.max").write_text("max 100000\n")
    assert processor_limit(tmp_path) is None
    (tmp_path / "cpu.max").write_text("28000 100000\n")
    assert processor_limit(tmp_path) == 0.28
