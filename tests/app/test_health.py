"""Figures on a run that tell what the program took."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.app.live.history import program_age_s

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"


def test_the_age_of_a_program_is_from_its_start_and_grows():
    earlier = program_age_s()
    assert 0 < earlier <= program_age_s()


@pytest.mark.long
def test_a_run_tells_its_first_command_and_its_memory():
    told = subprocess.run(
        [sys.executable, "-m", "stadimeter", "run", str(DEMO), "--frames", "2", "--speed", "0", "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    summary = json.loads(told.stdout)
    assert summary["first_command_s"] > 0
    assert summary["peak_memory_mb"] > 40
