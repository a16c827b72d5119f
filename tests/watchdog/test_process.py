"""The watchdog process as it is: a real process that watches over a real one, with a pretended tool for pins.

Pipes, signals and ends of processes are real, and waited for by what they lead to; no test asserts how soon.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

import pytest

from stadimeter.app.watchdog import PROGRAM
from stadimeter.testing.rig import eventually
from stadimeter.watchdog import __main__ as program
from stadimeter.watchdog.__main__ import RunWatch
from stadimeter.watchdog.plan import SafePlan
from support.processes import is_suspended

PARENT = """
import os, signal, subprocess, sys
program, lines = sys.argv[1:]
signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
child = subprocess.Popen([sys.executable, "-I", "-S", program, "hold", str(os.getpid())],
                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
child.stdin.write(lines.encode())
child.stdin.flush()
child.stdout.readline()
print(child.pid, flush=True)
for line in sys.stdin:
    if line == "close\\n":
        child.stdin.close()
    else:
        child.stdin.write(line.replace(";", "\\n").encode())
        child.stdin.flush()
    if line.startswith("acts"):
        child.stdout.read(1)
    print("passed on", flush=True)
"""
"""Starts a watchdog process as a run does, and passes on what it reads."""

HANGS_S = 60.0


class Run:
    """A process that stands in for a run, its watchdog process, and the pins that this drives."""

    def __init__(self, folder: Path, lines: str = "pin 18\nlimit 600\n") -> None:
        self._log = folder / "pins"
        self._numbers = count(10)
        self._errors = folder / "errors"
        tools = folder / "bin"
        tools.mkdir()
        (tools / "pinctrl").write_text(f'#!/bin/sh\necho "$*" >>"{self._log}"\n')
        (tools / "pinctrl").chmod(0o755)
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", PARENT, PROGRAM, lines],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"},
            )
        assert self.process.stdout
        self.watchdog = int(self.process.stdout.readline())

    def tell(self, line: str) -> None:
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "passed on\n"

    def acts(self, age_s: float = 0.0) -> None:
        self.tell(f"acts {next(self._numbers)} {time.monotonic()} {age_s}")

    @property
    def pins(self) -> list[str]:
        return self._log.read_text().splitlines() if self._log.exists() else []

    @property
    def said(self) -> str:
        return self._errors.read_text()

    def ended(self) -> bool:
        """Return whether the watchdog process has ended: with its parent gone, the system has taken it away too."""
        try:
            state = Path(f"/proc/{self.watchdog}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        return state == "Z"

    def close(self) -> None:
        for stream in (self.process.stdin, self.process.stdout):
            assert stream
            with suppress(BrokenPipeError):
                stream.close()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    run = Run(tmp_path)
    yield run
    run.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT, signal.SIGTERM])
def test_whatever_signal_ends_a_run_its_outputs_are_made_safe(run: Run, number: signal.Signals) -> None:
    run.process.send_signal(number)
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}
    assert run.said == ("watchdog: the program has ended without stopping its outputs: its outputs were made safe\n")


def test_a_run_that_acts_and_hangs_is_killed_first(run: Run) -> None:
    run.tell("limit 0.5")
    with suppress(AssertionError):  # on a slow computer it is killed before it says that it passed this on
        run.acts()
    run.process.send_signal(signal.SIGSTOP)
    assert run.process.wait(HANGS_S) == -signal.SIGKILL
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}
    assert "acting on data older than 0.5 s, and was killed" in run.said


def test_data_that_is_too_old_ends_a_run_however_often_it_says_so(run: Run) -> None:
    run.tell("limit 0.5")
    with suppress(BrokenPipeError, AssertionError):
        for _ in range(100_000):
            run.acts(age_s=0.7)
    assert run.process.wait(HANGS_S) == -signal.SIGKILL
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}


def test_a_run_whose_outputs_rest_may_be_stopped_for_as_long_as_anyone_likes(run: Run) -> None:
    run.tell("limit 0.5")
    run.tell(f"acts 1 {time.monotonic()} 0;rests 2")  # at once, however slow this computer is
    run.process.send_signal(signal.SIGSTOP)
    assert eventually(lambda: is_suspended(run.process.pid))
    time.sleep(1.0)  # twice the limit
    run.process.send_signal(signal.SIGCONT)
    run.tell("limit 600")
    run.acts()
    assert run.process.poll() is None
    assert run.pins == []


def test_a_longer_limit_counts_from_when_it_is_told(run: Run) -> None:
    run.tell("limit 0.5")
    run.tell("limit 600")
    run.acts(age_s=2.0)
    time.sleep(1.0)
    assert run.process.poll() is None


def test_a_run_that_has_stopped_its_outputs_itself_has_nothing_done_for_it(run: Run) -> None:
    run.acts()
    run.tell("done")
    assert eventually(run.ended, HANGS_S)
    run.process.kill()
    assert run.pins == []
    assert run.said == ""


def test_signals_to_all_processes_of_a_service_do_not_end_it_before_the_run(run: Run) -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT, signal.SIGXCPU):
        os.kill(run.watchdog, number)
    run.acts()
    assert not run.ended()
    run.process.kill()
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}


def test_a_pipe_that_is_closed_while_the_run_lives_makes_its_outputs_safe_too(run: Run) -> None:
    run.tell("close")
    assert eventually(run.ended, HANGS_S)
    assert run.process.poll() is None
    assert run.pins == ["set 18 op dl"] * 2


def test_a_stop_waits_for_no_process_that_is_slow_to_die_and_is_sent_again_after_it(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened: list[str] = []

    class SlowToDie(RunWatch):
        def run(self) -> str:
            return "it hung"

        def waits_until_gone(self, within_s: float) -> bool:
            happened.append(f"waited {within_s} s")
            return within_s > 0.0

    def stop(_plan: SafePlan) -> list[str]:
        happened.append("stopped")
        return []

    monkeypatch.setattr(program, "RunWatch", SlowToDie)
    monkeypatch.setattr(program, "make_safe", stop)
    program.hold(run.process.pid)
    assert happened == ["waited 0.0 s", "stopped", "waited 1.0 s", "stopped"]


def test_what_could_not_be_made_safe_is_said(tmp_path: Path) -> None:
    run = Run(tmp_path, "serial /dev/ttyNone 57600 0d\npin 99\nlimit 1\n")
    run.process.kill()
    assert eventually(run.ended, HANGS_S)
    assert run.said.splitlines() == [
        "watchdog: the program has ended without stopping its outputs: its outputs are NOT all safe",
        "watchdog: pin '99': not the number of a GPIO, 0 to 27",
        "watchdog: serial /dev/ttyNone: there is no such port",
    ]
    run.close()


def test_it_is_small_and_loads_nothing_but_a_few_modules_of_the_standard_library(run: Run) -> None:
    run.acts()
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{run.watchdog}/status").read_text().splitlines() if ":" in line
    )
    print("resident:", status["VmHWM"].strip())
    assert int(status["VmRSS"].split()[0]) < 16_000, "kB; 10 MB with Debian's Python, whose libraries others share"
    maps = Path(f"/proc/{run.watchdog}/maps").read_text()
    assert "numpy" not in maps
    assert "cv2" not in maps
