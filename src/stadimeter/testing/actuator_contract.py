"""The contracts of every actuator and of every button: subclass one with a fixture ``make_rig``.

`stadimeter.testing.rig` shows how.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import ClassVar

import pytest

from stadimeter.actuators.protocol import Actuator, Button
from stadimeter.core.command import LevelCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError
from stadimeter.testing.output_contract import OutputContract, raised_by
from stadimeter.testing.rig import Contract, OutputRig, Rig

ABSENT, FAILS = "absent", "fails"

LEVELS = (0.0, 0.004, 0.25, 0.49, 0.5, 0.7, 0.999, 1.0)


class ActuatorRig(OutputRig[Actuator], frozen=True, kw_only=True):
    """An actuator with its device.

    Its faults are `ABSENT` (the device cannot be opened: another program has it, or it is not there) and `FAILS`
    (whatever is written to the device, the vendor's library raises its error).

    Attributes:
        output: Reads from the wire what the device really does, from 0, off, to 1, full, as exactly as it can be read.
            After closing, what the device did when it was let go.
    """

    output: Callable[[], float]
    settles_s: ClassVar[float] = 0.0

    def apply(self, level: float) -> LevelCommand:
        """Apply a level that a frame of this moment justifies."""
        command = LevelCommand(output="it", level=level, captured_at_s=self.clock.now_s())
        applied: LevelCommand = self.timed("apply", command)
        return applied

    def act(self) -> LevelCommand:
        """Apply the full level."""
        return self.apply(1.0)

    def rests(self) -> bool:
        """Check whether the device is off."""
        return self.output() == 0.0

    def outputs(self, seconds: float, each_tick: Callable[[], object] = lambda: None) -> list[float]:
        """Let time pass, and return what the device did from one tick to the next."""
        seen = [self.output()]

        def look() -> None:
            each_tick()
            seen.append(self.output())

        self.pass_time_s(seconds, look)
        return seen


MakeRig = Callable[[], ActuatorRig]


@contextmanager
def _open_rig(make_rig: MakeRig) -> Iterator[ActuatorRig]:
    rig = make_rig()
    rig.device.open()
    yield rig
    rig.device.close()


class ActuatorContract(OutputContract):
    """The tests."""

    @pytest.fixture(params=[ABSENT, FAILS])
    def opening_fault(self, request: pytest.FixtureRequest) -> str:
        """Return each fault that keeps the device from being opened."""
        return str(request.param)

    @pytest.fixture(params=[FAILS])
    def fault(self, request: pytest.FixtureRequest) -> str:
        """Return each fault that may come up in use."""
        return str(request.param)

    def test_what_is_reported_would_do_the_same_if_it_were_asked_for(self, make_rig: MakeRig) -> None:
        for level in LEVELS:
            with _open_rig(make_rig) as asked, _open_rig(make_rig) as reported:
                command = LevelCommand(output="it", level=level, captured_at_s=asked.clock.now_s())
                applied = asked.device.apply(command)
                assert (applied.output, applied.captured_at_s) == (command.output, command.captured_at_s), level
                assert reported.apply(applied.level) == applied, level
                assert asked.outputs(1.0) == reported.outputs(1.0), level

    def test_levels_that_act_alike_are_reported_alike(self, make_rig: MakeRig) -> None:
        """A driver that rounds and reports what was asked for is found by two levels that become one on the wire."""
        steady: dict[float, set[float]] = {}
        for level in (0.1, 0.25, 0.5, 0.7, 0.9):
            for near in (level, level + 1e-6, level + 1e-3):
                with _open_rig(make_rig) as rig:
                    applied = rig.apply(near).level
                    rig.pass_time_s(1.0)  # a kick is over
                    seen = set(rig.outputs(1.0))
                if len(seen) == 1:  # a pattern may tell levels apart that look alike for a second
                    steady.setdefault(seen.pop(), set()).add(applied)
        reported_twice = {wire: reported for wire, reported in steady.items() if len(reported) > 1}
        assert not reported_twice, "the same on the wire, but reported as different levels: return what was applied"

    def test_acting_and_a_level_above_zero_are_the_same(self, make_rig: MakeRig) -> None:
        """A level of 0 is reported exactly when the device rests; the full one begins at once and has no gaps."""
        for level in (0.2, 0.7, 1.0):
            with _open_rig(make_rig) as rig:
                applied = rig.apply(level)
                seen = rig.outputs(2.0)
                assert (max(seen) > 0.0) == (applied.level > 0.0), level
        assert min(seen) > 0.0

    def test_the_same_command_again_changes_nothing(self, make_rig: MakeRig) -> None:
        """Neither a kick nor a beep begins anew because the command is repeated."""
        for level in (0.0, 0.3, 0.7, 1.0):
            with _open_rig(make_rig) as once, _open_rig(make_rig) as again:
                once.apply(level)
                again.apply(level)
                expected = once.outputs(3.0)
                assert again.outputs(3.0, partial(again.apply, level)) == expected, level

    def test_stop_switches_off_at_once_and_for_good(self, make_rig: MakeRig) -> None:
        """It holds within a pattern or a kick too, and ticks do not wake it."""
        for after_s in (0.0, 0.02, 0.04, 0.1, 0.3, 0.5):
            with _open_rig(make_rig) as rig:
                rig.apply(0.7)
                rig.outputs(after_s)
                rig.device.stop()
                assert set(rig.outputs(3.0)) == {0.0}, after_s

    def test_every_level_gives_a_level_and_a_higher_one_never_a_lower(self, opened: ActuatorRig) -> None:
        """A level applied is a level again: `LevelCommand` refuses anything else; 0 rests, and full stays full."""
        applied = []
        for number in range(402):
            applied.append(opened.apply(number / 401).level)
            assert 0.0 <= applied[-1] <= 1.0
            assert 0.0 <= opened.output() <= 1.0
        assert applied == sorted(applied), "rounding keeps the order"
        assert (applied[0], applied[-1]) == (0.0, 1.0)
        opened.apply(0.0)
        assert opened.rests()

    def _use(self, rig: OutputRig[Actuator]) -> None:
        """Write twice: a driver may leave out what it believes to be written already."""
        for level in (0.0, 1.0):
            rig.device.apply(LevelCommand(output="it", level=level, captured_at_s=rig.clock.now_s()))


class ButtonRig(Rig[Button], frozen=True, kw_only=True):
    """A button with its device.

    Its faults are `ABSENT` (the device cannot be opened) and `FAILS` (whatever is read from it, the vendor's library
    raises its error).

    Attributes:
        press: Presses the button at the wire (True), or lets go of it.
        is_held: Whether the device is taken (a pin reserved), seen from outside of the driver.
    """

    press: Callable[[bool], None]
    is_held: Callable[[], bool]

    def is_pressed(self) -> bool:
        """Ask the driver, which must answer at once."""
        return bool(self.timed("is_pressed"))


class ButtonContract(Contract):
    """The tests."""

    def test_it_is_pressed_for_as_long_as_it_is_held_down(self, opened: ButtonRig) -> None:
        for _ in range(2):
            assert not opened.is_pressed()
            opened.press(True)
            assert opened.is_pressed()
            assert opened.is_pressed()
            opened.press(False)
        opened.device.close()
        opened.press(True)
        opened.device.open()
        assert opened.is_pressed(), "it was held down when it was opened"

    def test_it_is_held_from_open_to_close_however_often_these_come(self, rig: ButtonRig) -> None:
        assert not rig.is_held(), "the constructor touches no hardware"
        for _ in range(2):
            rig.device.close()
            with pytest.raises(DeviceClosedError):
                rig.device.is_pressed()
            rig.device.open()
            rig.device.open()
            assert rig.is_held()
            rig.device.close()
            assert not rig.is_held()

    def test_one_that_cannot_be_opened_raises_and_is_not_held(self, rig: ButtonRig) -> None:
        rig.begin(ABSENT)
        assert isinstance(raised_by(rig.device.open), DeviceOpenError)
        rig.device.close()
        rig.end(ABSENT)
        assert not rig.is_held()

    def test_one_that_fails_raises_one_of_our_errors_and_can_be_opened_again(self, opened: ButtonRig) -> None:
        opened.begin(FAILS)
        error = raised_by(opened.device.is_pressed)
        assert error, "the device fails, and the driver does not notice"
        assert not isinstance(error, DeviceClosedError)
        with suppress(DriverError):
            opened.device.close()
        assert not opened.is_held()
        opened.end(FAILS)
        opened.device.open()
        opened.press(True)
        assert opened.is_pressed()
