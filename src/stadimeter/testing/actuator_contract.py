"""The contract of every actuator: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stadimeter.actuators.protocol import Actuator
from stadimeter.core.command import LevelCommand
from stadimeter.testing.output_contract import OutputContract
from stadimeter.testing.rig import OutputRig

ABSENT, FAILS = "absent", "fails"

LEVELS = (0.0, 0.004, 0.25, 0.49, 0.5, 0.7, 0.999, 1.0)
levels = st.floats(min_value=0.0, max_value=1.0)
# `make_rig` makes a new rig for each example, so that it lives for a whole test does not matter; nor does it which
# subclass runs an example.
each_example = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorRig(OutputRig[Actuator]):
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
        """Return whether the device is off."""
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

    def test_the_full_level_acts_at_once_and_lasts(self, opened: ActuatorRig) -> None:
        """The full level begins within `apply` and has no gaps."""
        opened.apply(1.0)
        assert min(opened.outputs(2.0)) > 0.0

    def test_only_the_level_of_a_command_may_be_changed(self, opened: ActuatorRig) -> None:
        for level in LEVELS:
            asked = LevelCommand(output="it", level=level, captured_at_s=opened.clock.now_s())
            applied = opened.device.apply(asked)
            assert (applied.output, applied.captured_at_s) == (asked.output, asked.captured_at_s), level

    def test_what_is_reported_would_do_the_same_if_it_were_asked_for(self, make_rig: MakeRig) -> None:
        for level in LEVELS:
            with _open_rig(make_rig) as asked, _open_rig(make_rig) as reported:
                applied = asked.apply(level)
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
        """A level of 0 is reported exactly when the device rests."""
        for level in (0.2, 0.7, 1.0):
            with _open_rig(make_rig) as rig:
                applied = rig.apply(level)
                acts = max(rig.outputs(2.0)) > 0.0
                assert acts == (applied.level > 0.0), level

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

    @each_example
    @given(level=levels)
    def test_every_level_gives_a_level(self, make_rig: MakeRig, level: float) -> None:
        """What was applied is a level again, for `LevelCommand` refuses anything else, and 0 rests."""
        rig = make_rig()
        rig.device.open()
        assert 0.0 <= rig.apply(level).level <= 1.0
        assert 0.0 <= rig.output() <= 1.0
        assert rig.apply(0.0).level == 0.0
        assert rig.rests()
        rig.device.close()

    @each_example
    @given(pair=st.tuples(levels, levels))
    def test_a_higher_level_is_never_applied_as_a_lower_one(self, make_rig: MakeRig, pair: tuple[float, float]) -> None:
        """Rounding keeps the order, and the full level stays full."""
        rig = make_rig()
        rig.device.open()
        lower, higher = (rig.apply(level).level for level in sorted(pair))
        assert lower <= higher
        assert rig.apply(1.0).level == 1.0
        rig.device.close()

    def _use(self, rig: OutputRig[Actuator]) -> None:
        """Write twice: a driver may leave out what it believes to be written already."""
        for level in (0.0, 1.0):
            rig.device.apply(LevelCommand(output="it", level=level, captured_at_s=rig.clock.now_s()))
