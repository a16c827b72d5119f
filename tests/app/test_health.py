"""Figures on a run that tell what the program took."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.app.live.health import peak_memory_mb
from stadimeter.app.live.history import program_age_s

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"
LARGE_MB = 300
ASK = "from stadimeter.app.live.health import peak_memory_mb; print(peak_memory_mb())"


def test_the_age_of_a_program_is_from_its_start_and_grows():
    earlier = program_age_s()
    assert 0 < earlier <= program_age_s()


@pytest.mark.long
def test_the_age_of_a_program_counts_what_python_itself_took():
    started = "import time; began = time.perf_counter(); from stadimeter.app.live.health import program_age_s; print("
    told = subprocess.run(
        [sys.executable, "-c", started + "program_age_s() > time.perf_counter() - began)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert told.stdout.strip() == "True"


@pytest.mark.long
def test_the_memory_of_a_program_is_its_own_and_not_that_of_the_one_that_started_it():
    large = bytes(LARGE_MB * 1_000_000)  # zeros that nobody touches take no memory
    large = large.replace(b"\0", b"\1")
    assert peak_memory_mb() > LARGE_MB
    asked = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=True)
    assert 5 < float(asked.stdout) < LARGE_MB
    assert large[-1] == 1


@pytest.mark.long
def test_a_run_tells_its_first_command_and_its_memory():
    told = subprocess.run(
        [sys.executable, "-m", "stadimeter", "run", str(DEMO), "--frames", "2", "--speed", "0", "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    summary = json.loads(told.stdout)
    assert summary["first_command_s"] > 0
    assert summary["peak_memory_mb"] > 40
