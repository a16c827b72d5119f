"""The guides show what their commands really print."""

import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("guide", ["rules.md", "recording.md", "robots.md", "certificate.md", "teaching.md"])
def test_every_command_of_a_guide_prints_what_is_shown(guide):
    command = [sys.executable, DOCS / "make_output.py", DOCS / guide, "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
