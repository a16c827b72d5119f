"""Standard streams that are closed, or go to a disk that is full, cost a line and never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

START = f'exec "{sys.executable}" -m stadimeter'


def run(command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", "-c", f"{START} {command}"], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("closed", ["<&-", ">&-", "<&- >&- 2>&-"])
def test_a_stream_that_is_closed_is_as_one_to_nowhere(closed: str) -> None:
    done = run(f"--version {closed}")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("stadimeter ") == (">&-" not in closed)


def test_questions_without_a_standard_input_are_refused_as_those_without_a_terminal() -> None:
    done = run("init x.toml <&-")
    assert done.returncode == 2
    assert done.stderr.startswith("error: init asks questions, and there is no terminal here")


def test_what_is_typed_and_is_no_text_is_refused_in_a_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "stadimeter", "web", str(tmp_path / "r.toml"), "--set-password"]
    env = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}  # as with the languages of most people
    done = subprocess.run(command, input=b"b\xe4d\n" * 2, capture_output=True, check=False, timeout=120, env=env)
    assert done.returncode == 2
    assert done.stderr.decode().splitlines()[-1] == "error: a password has 8 to 500 characters"


@pytest.mark.parametrize("command", ["--version", "help", "check none.toml --json"])
def test_a_disk_that_is_full_is_said_in_a_line(command: str) -> None:
    done = run(f"{command} >/dev/full")
    assert done.returncode == 2
    assert done.stderr == "error: what is printed cannot be written: no space left on device\n"
    assert run(f"{command} >/dev/full 2>&1").returncode == 2


def test_what_is_opened_first_does_not_become_standard_output() -> None:
    code = (
        "from stadimeter.__main__ import open_standard_streams as o; o(); import os; os._exit(os.open('/dev/null', 0))"
    )
    done = subprocess.run(["sh", "-c", f'exec "{sys.executable}" -c "{code}" <&- >&- 2>&-'], check=False)
    assert done.returncode > 2
