"""Keys, pressed on a pseudo-terminal as a person presses them."""

from __future__ import annotations

import os
import pty
import signal
import termios
from contextlib import closing

import pytest

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.loop import Loop
from stadimeter.cli.demo import fault_keys
from stadimeter.cli.keyboard import Keyboard, RunKeys
from support.terminal import Terminal


@pytest.mark.long
def test_keys_pause_and_explain_the_demonstration_make_things_go_wrong_and_end_it() -> None:
    with closing(Terminal("demo")) as it:
        it.wait_for(" unplug robot ")
        it.press("h")
        it.wait_for("The ball is hidden on purpose")
        it.wait_for(" show ball ")
        it.press("h")
        it.wait_for("The ball is back in sight")
        it.press(" ")
        it.wait_for(" PAUSED ")
        it.press("?")
        it.wait_for("what changed, the newest first")
        it.press("p")
        it.wait_for(" ACTIVE ")
        it.press("q")
        assert it.ended() == 0
        assert "Ended: the key q was pressed." in it.shown
        assert "stadimeter init" in it.shown
        assert it.is_as_before()


@pytest.mark.long
def test_a_signal_gives_the_terminal_back_also_while_the_demonstration_is_paused() -> None:
    for number, keys in [(signal.SIGINT, ""), (signal.SIGTERM, " ")]:
        with closing(Terminal("demo")) as it:
            it.wait_for(" quit ")
            it.press(keys)
            it.wait_for(" go on " if keys else " ACTIVE ")
            assert not it.is_as_before()
            assert it.ended(number) == 0
            assert it.is_as_before()
            assert "\x1b[?1049l" in it.raw


@pytest.mark.long
def test_a_run_that_is_watched_has_keys_too_and_no_others() -> None:
    with closing(Terminal("run", "config/demo.toml", "--watch", "--no-state")) as it:
        shown = it.wait_for(" help ")
        assert "pause" not in shown
        it.press("q")
        assert it.ended() == 0
        assert it.is_as_before()


def test_without_a_terminal_no_key_is_ever_pressed() -> None:
    read, write = os.pipe()
    with Keyboard(read) as keyboard:
        os.write(write, b"q")
        assert not keyboard.is_there
        assert keyboard.pressed() == ""
    os.close(read)
    os.close(write)


def test_a_terminal_of_another_program_is_left_alone() -> None:
    board, there = pty.openpty()
    before = termios.tcgetattr(there)
    with Keyboard(there) as keyboard:
        assert not keyboard.is_there
        assert termios.tcgetattr(there) == before
    os.close(board)
    os.close(there)


class Pressed(Keyboard):
    """A keyboard whose keys are given in advance, one at each look."""

    def __init__(self, *keys: str) -> None:
        super().__init__(-1)
        self.left = list(keys)

    @property
    def is_there(self) -> bool:
        return True

    def pressed(self, wait_s: float = 0.0) -> str:
        return self.left.pop(0) if self.left else ""


def test_each_key_again_undoes_what_it_did() -> None:
    loop = Loop(build(demo_configuration(), speed=None))
    world = loop.parts.world
    assert world is not None
    for key, fault in (("h", "hide-target"), ("f", "freeze-camera"), ("u", "unplug-base")):
        for is_wrong in (True, False):
            RunKeys(loop, fault_keys(loop), keyboard=Pressed(key)).attend(lambda: None)
            assert world.goes_wrong(fault) is is_wrong


def test_while_the_run_is_paused_its_clock_stands_still() -> None:
    loop = Loop(build(demo_configuration(), speed=None))
    keys = RunKeys(loop, can_pause=True, keyboard=Pressed(" ", "", "", "p"))
    drawn: list[tuple[float, bool]] = []
    keys.attend(lambda: drawn.append((loop.parts.clock.now_s(), keys.is_paused)))
    assert [paused for _, paused in drawn] == [True, True, True, False]
    assert len({now_s for now_s, _ in drawn}) == 1
