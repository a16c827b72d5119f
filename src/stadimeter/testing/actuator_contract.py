"""What every actuator must do. Subclass `ActuatorContract` with a fixture ``make_rig``, and pytest runs it all.

::

    class TestMyActuator(ActuatorContract):
        @pytest.fixture
        def make_rig(self) -> Callable[[], ActuatorRig]:
            return my_rig
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stadimeter.actuators.protocol import Actuator
from stadimeter.core.command import LevelCommand
from stadimeter.errors import DeviceClosedError
from stadimeter.testing.manual_clock import ManualClock

TICK_S = 0.02

levels = st.floats(min_value=0.0, max_value=1.0)
# `make_rig` makes a new rig for each example, so that it lives for a whole test does not matter; nor does it which
# subclass runs an example.
each_example = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorRig:
    """An actuator that was not opened yet, and what is needed to watch it.

    Attributes:
        actuator: The actuator.
        clock: The clock that it was given.
        output: Reads what the device really does, from 0, off, to 1, full: not what the driver believes. After
            closing, what the device did when it was let go.
        held: Tells whether the device is taken.
    """

    actuator: Actuator
    clock: ManualClock
    output: Callable[[], float]
    held: Callable[[], bool]

    def command(self, level: float) -> LevelCommand:
        """Return a command that is justified by a frame of this moment.

        Args:
            level: 0 to 1.

        Returns:
            The command.
        """
        return LevelCommand(output="it", level=level, captured_at_s=self.clock.now_s())

    def run_s(self, seconds: float, each_tick: Callable[[], object] = lambda: None) -> list[float]:
        """Let time pass, ticking as the app does.

        Args:
            seconds: For how long.
            each_tick: What else to do before each tick.

        Returns:
            What the device did, from one tick to the next.
        """
        outputs = []
        for _ in range(round(seconds / TICK_S)):
            self.clock.advance_s(TICK_S)
            each_tick()
            self.actuator.tick(self.clock.now_s())
            outputs.append(self.output())
        return outputs


class ActuatorContract:
    """The tests."""

    @pytest.fixture
    def make_rig(self) -> Callable[[], ActuatorRig]:
        """Return a function that makes a new rig. Override it."""
        raise NotImplementedError("subclass ActuatorContract and override the fixture make_rig")

    @pytest.fixture
    def rig(self, make_rig: Callable[[], ActuatorRig]) -> ActuatorRig:
        """Return a rig that is not open."""
        return make_rig()

    @pytest.fixture
    def opened(self, rig: ActuatorRig) -> ActuatorRig:
        """Return a rig that is open."""
        rig.actuator.open()
        return rig

    def test_the_constructor_touches_no_hardware(self, rig: ActuatorRig) -> None:
        """Nothing is taken before it is opened."""
        assert not rig.held()

    def test_it_opens_off(self, opened: ActuatorRig) -> None:
        """It takes the device and leaves it off, also when time passes."""
        assert opened.held()
        assert opened.output() == 0.0
        assert set(opened.run_s(1.0)) == {0.0}

    def test_the_full_level_acts_at_once_and_lasts(self, opened: ActuatorRig) -> None:
        """The full level begins within `apply` and has no gaps."""
        opened.actuator.apply(opened.command(1.0))
        assert opened.output() > 0.0
        assert min(opened.run_s(2.0)) > 0.0

    @pytest.mark.parametrize("level", [0.0, 0.004, 0.25, 0.49, 0.5, 0.7, 0.999, 1.0])
    def test_apply_returns_what_was_applied(self, opened: ActuatorRig, level: float) -> None:
        """Only the level may differ, and what was applied once is applied exactly."""
        asked = opened.command(level)
        applied = opened.actuator.apply(asked)
        assert (applied.output, applied.captured_at_s) == (asked.output, asked.captured_at_s)
        assert opened.actuator.apply(applied) == applied

    @pytest.mark.parametrize("level", [0.2, 0.7, 1.0])
    def test_acting_and_a_level_above_zero_are_the_same(self, opened: ActuatorRig, level: float) -> None:
        """A level of 0 is reported exactly when the device rests."""
        applied = opened.actuator.apply(opened.command(level))
        acts = max(opened.run_s(2.0)) > 0.0
        assert acts == (applied.level > 0.0)

    @pytest.mark.parametrize("level", [0.0, 0.3, 0.7, 1.0])
    def test_the_same_command_again_changes_nothing(self, make_rig: Callable[[], ActuatorRig], level: float) -> None:
        """Neither a kick nor a beep begins anew because the command is repeated."""
        once, again = make_rig(), make_rig()
        for rig in (once, again):
            rig.actuator.open()
            rig.actuator.apply(rig.command(level))
        assert once.run_s(3.0) == again.run_s(3.0, lambda: again.actuator.apply(again.command(level)))

    @pytest.mark.parametrize("after_s", [0.0, 0.02, 0.04, 0.1, 0.3, 0.5])
    def test_stop_switches_off_at_once_and_for_good(self, opened: ActuatorRig, after_s: float) -> None:
        """It holds in the middle of a pattern or a kick too, and ticks do not wake it."""
        opened.actuator.apply(opened.command(0.7))
        opened.run_s(after_s)
        opened.actuator.stop()
        assert opened.output() == 0.0
        assert set(opened.run_s(3.0)) == {0.0}

    def test_it_acts_again_after_a_stop(self, opened: ActuatorRig) -> None:
        """A stop does not latch."""
        opened.actuator.apply(opened.command(1.0))
        opened.actuator.stop()
        opened.actuator.apply(opened.command(1.0))
        assert opened.output() > 0.0

    def test_close_stops_first_and_may_come_again(self, opened: ActuatorRig) -> None:
        """The device is off when it is let go."""
        opened.actuator.apply(opened.command(1.0))
        opened.actuator.close()
        assert opened.output() == 0.0
        assert not opened.held()
        opened.actuator.close()

    def test_using_it_before_it_is_open_raises(self, rig: ActuatorRig) -> None:
        """Nothing is dropped silently."""
        self._check_unusable(rig)

    def test_using_it_after_it_was_closed_raises(self, opened: ActuatorRig) -> None:
        """Nothing is dropped silently."""
        opened.actuator.close()
        self._check_unusable(opened)

    def test_stopping_and_closing_what_is_closed_does_nothing(self, rig: ActuatorRig) -> None:
        """Whoever cleans up need not know what was opened."""
        rig.actuator.stop()
        rig.actuator.close()
        assert not rig.held()

    def test_it_can_be_opened_again(self, opened: ActuatorRig) -> None:
        """What it did before is forgotten, and it works."""
        opened.actuator.apply(opened.command(0.7))
        opened.actuator.close()
        opened.actuator.open()
        assert opened.held()
        assert set(opened.run_s(2.0)) == {0.0}
        opened.actuator.apply(opened.command(1.0))
        assert opened.output() > 0.0

    @each_example
    @given(level=levels)
    def test_every_level_gives_a_level(self, make_rig: Callable[[], ActuatorRig], level: float) -> None:
        """What was applied is a level again, for `LevelCommand` refuses anything else, and 0 rests."""
        rig = make_rig()
        rig.actuator.open()
        assert 0.0 <= rig.actuator.apply(rig.command(level)).level <= 1.0
        assert 0.0 <= rig.output() <= 1.0
        assert rig.actuator.apply(rig.command(0.0)).level == 0.0
        assert rig.output() == 0.0
        rig.actuator.close()

    @each_example
    @given(pair=st.tuples(levels, levels))
    def test_a_higher_level_is_never_applied_as_a_lower_one(
        self, make_rig: Callable[[], ActuatorRig], pair: tuple[float, float]
    ) -> None:
        """Rounding keeps the order, and the full level stays full."""
        rig = make_rig()
        rig.actuator.open()
        lower, higher = (rig.actuator.apply(rig.command(level)).level for level in sorted(pair))
        assert lower <= higher
        assert rig.actuator.apply(rig.command(1.0)).level == 1.0
        rig.actuator.close()

    def _check_unusable(self, rig: ActuatorRig) -> None:
        with pytest.raises(DeviceClosedError):
            rig.actuator.apply(rig.command(0.5))
        with pytest.raises(DeviceClosedError):
            rig.actuator.tick(rig.clock.now_s())
        assert not rig.held()
