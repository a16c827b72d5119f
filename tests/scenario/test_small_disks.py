"""The program on a disk that it may not write, on one that is full, and how little it writes to one at rest."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.cuts import needs_strace
from support.saves import LENS, setup_files

PROGRAM = f"{sys.executable} -m stadimeter"

READ_ONLY = """
mount --make-rprivate /
awk '{print $2}' /proc/self/mounts | while read at; do mount -o remount,bind,ro "$at" 2>/dev/null; done
mount --bind . . && mount -o remount,bind,rw "$PWD"
cd / && cd "$OLDPWD"
touch /there-is-room 2>/dev/null && exit 77
"""
"""Makes every file system read-only but the working directory."""

FULL = """
mount --make-rprivate /
mkdir small && mount -t tmpfs -o size=1m none small && cp *.toml small && cd small
"""
"""Makes a disk of 1 MB and goes there; `FILL` fills it."""

FILL = "cat /dev/zero >ballast 2>/dev/null\n"


def may_mount() -> bool:
    """Return whether this is root on a machine where one may mount."""
    command = ["unshare", "-m", "mount", "--make-rprivate", "/"]
    return os.geteuid() == 0 and bool(shutil.which("unshare")) and not subprocess.run(command, check=False).returncode


pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not may_mount(), reason="needs root, who may mount"),
    needs_strace(),
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a configuration, its camera file and a picture."""
    for name, text in setup_files(LENS, "1 m").items():
        (tmp_path / name).write_text(text)
    picture = np.full((480, 640, 3), 90, np.uint8)
    cv2.circle(picture, (320, 240), 40, (60, 200, 120), -1, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "ball.png"), picture)
    return tmp_path


def apart(folder: Path, script: str) -> subprocess.CompletedProcess[str]:
    """Run a script in the folder, with mounts of its own."""
    environ = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    command = ["unshare", "-m", "sh", "-c", script]
    return subprocess.run(command, cwd=folder, env=environ, capture_output=True, text=True, check=False)


def test_one_writable_folder_is_enough_and_nothing_else_is_tried(folder: Path) -> None:
    before = {file.name for file in folder.iterdir()}
    strace = "strace -f -qq -o refused -e trace=file,desc -e status=failed"
    done = apart(
        folder,
        READ_ONLY
        + "set -e\n"
        + f"{PROGRAM} check stadimeter.toml >/dev/null\n"
        + f"{strace} {PROGRAM} run stadimeter.toml --state run.sqlite3 --journal run.jsonl --seconds 1 --json\n"
        + f'{PROGRAM} measure ball.png --ball "10 cm" --hsv "35,80,60:90,255,255" --camera camera.toml\n',
    )
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    tried = [line for line in (folder / "refused").read_text().splitlines() if "EROFS" in line]
    assert [line for line in tried if "__pycache__" not in line] == [], "Python's own copies may be left out"
    of_the_service = {"stadimeter.log", "safe-outputs.conf", "timeline"}
    assert {file.name for file in folder.iterdir()} - before == {"refused", "run.sqlite3", "run.jsonl"} | of_the_service


def test_a_full_disk_is_told_in_a_sentence_each_and_the_run_goes_on(folder: Path) -> None:
    run = f"{PROGRAM} run stadimeter.toml --seconds 1 --json"
    done = apart(
        folder,
        FULL
        + f"{run} --state run.sqlite3 >/dev/null\ncp run.sqlite3 camera.toml ..\n"
        + FILL
        + f"{run} --state run.sqlite3 --journal run.jsonl --record run.mcap\n"
        + f"{run} --state new.sqlite3\n"
        + f"{PROGRAM} init . --example demo && exit 1\n"
        + "cmp run.sqlite3 ../run.sqlite3 && cmp camera.toml ../camera.toml && ls -A\n",
    )
    assert done.returncode == 0, done.stderr
    runs = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [run["cycles"] for run in runs] == [runs[0]["cycles"]] * 2
    told = done.stderr.lower()
    for name in ("run.jsonl: no space left", "run.mcap: no space left", "new.sqlite3 cannot be written: "):
        assert name in told
    for name in ("run.sqlite3 cannot be written: ", "demo.toml: it cannot be written: no space left"):
        assert name in told
    assert "traceback" not in told
    assert not re.search(r"\.part$", done.stdout, re.MULTILINE), "what could not be written is removed"


def test_a_run_at_rest_writes_nothing_between_its_beginning_and_its_end(folder: Path) -> None:
    strace = ["strace", "-f", "-y", "-qq", "-ttt", "--seccomp-bpf", "-o", "flushes", "-e", "trace=fsync,fdatasync"]
    run = ["run", "stadimeter.toml", "--speed", "0", "--seconds", "136", "--state", "run.sqlite3", "--json"]
    subprocess.run([*strace, *PROGRAM.split(), *run], cwd=folder, check=True, capture_output=True)
    flushes = [line.split() for line in (folder / "flushes").read_text().splitlines() if "run.sqlite3" in line]
    at_s = [float(when) for _, when, *_ in flushes]
    # How many saves the beginning takes depends on how fast it runs: the last of them is due 1 s after the first.
    third_s = (at_s[-1] - at_s[0]) / 3
    assert third_s > 0
    # A save every 30 s would be due twice in the middle third.
    assert not [when_s for when_s in at_s if third_s <= when_s - at_s[0] <= 2 * third_s]
