"""What pins do when the process that drives them stops, hangs or ends: a real process, with pins in a shared file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from stadimeter.testing.rig import eventually
from support.processes import is_suspended
from support.simulated_run import SIMULATED_BALL

LAUNCHER = """
import os, sys
from gpiozero.pins.mock import MockPWMPin

set_state = MockPWMPin._set_state
register = os.open(sys.argv.pop(1), os.O_WRONLY)

def latched(self, value):
    set_state(self, value)
    if self.info.name == "GPIO17":
        os.pwrite(register, b"1" if value else b"0", 0)

MockPWMPin._set_state = latched
from stadimeter.cli import main
main()
"""
"""Runs the program on gpiozero's mock pins, and keeps the level of one where it outlives the process, as a real one."""

CONFIGURATION = (
    SIMULATED_BALL
    + """
[actuators.lamp]
driver = "led"
pin = 17

[rules.seen]
actuator = "lamp"
when = { below = "50 m" }

[world]
"""
)


class Lamp:
    """A lamp on a pin, and the program that drives it."""

    def __init__(self, folder: Path, text: str = CONFIGURATION) -> None:
        self._register = folder / "register"
        self._register.write_bytes(b"0")
        configuration = folder / "lamp.toml"
        configuration.write_text(text)
        command = [sys.executable, "-c", LAUNCHER, str(self._register), "run", str(configuration), "--no-state"]
        environment = {**os.environ, "GPIOZERO_PIN_FACTORY": "mock"}
        self.program = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, process_group=0
        )

    @property
    def is_on(self) -> bool:
        return self._register.read_bytes() == b"1"


@pytest.fixture
def lamp(tmp_path: Path) -> Iterator[Lamp]:
    lamp = Lamp(tmp_path)
    try:
        eventually(lambda: lamp.is_on)
        yield lamp
    finally:
        lamp.program.kill()
        lamp.program.wait()


def test_a_pin_keeps_its_level_while_the_program_is_stopped_and_when_it_is_killed(lamp):
    lamp.program.send_signal(signal.SIGSTOP)
    time.sleep(0.5)  # longer than the lease: what is not running ends no lease
    assert lamp.is_on
    lamp.program.kill()
    lamp.program.wait()
    assert lamp.is_on


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, pytest.param(signal.SIGUSR2, marks=pytest.mark.long)]
)
def test_a_pin_is_off_when_the_program_was_asked_to_end(lamp, number):
    lamp.program.send_signal(number)
    lamp.program.wait(timeout=120)
    assert not lamp.is_on


def test_a_pin_is_off_while_the_program_is_suspended_by_its_shell_and_on_again_after_it(lamp):
    lamp.program.send_signal(signal.SIGTSTP)
    assert eventually(lambda: is_suspended(lamp.program.pid))
    assert not lamp.is_on
    lamp.program.send_signal(signal.SIGCONT)
    assert eventually(lambda: lamp.is_on)


def test_a_status_led_blinks_while_the_program_runs_and_is_dark_when_it_was_asked_to_end(tmp_path):
    table = '[actuators.lamp]\ndriver = "led"\npin = 17\n'
    assert table in CONFIGURATION
    tables = table.replace("17", "18") + table.replace("actuators.lamp", "status_led")
    light = Lamp(tmp_path, CONFIGURATION.replace(table, tables))
    try:
        eventually(lambda: light.is_on)
        eventually(lambda: not light.is_on)
        eventually(lambda: light.is_on)
    finally:
        light.program.terminate()
        light.program.wait(timeout=120)
    assert not light.is_on
