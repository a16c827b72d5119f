"""What every robot base must do. Subclass `BaseContract` and give it the fixture ``stand``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import pytest

from stadimeter.bases.protocol import MobileBase
from stadimeter.core.command import TwistCommand
from stadimeter.errors import CommandRangeError, DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.testing.manual_clock import ManualClock

STANDING_MPS = 1e-3
STANDING_RADPS = 1e-2
LOOP_S = 0.05
TICK_S = 0.01
LOST_WITHIN_S = 1.0
FAULTS = ("unplugged", "silent", "takes no bytes")


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseStand:
    """A base with its counterpart, real or emulated, and what can be seen of both.

    Attributes:
        base: The base, made but not opened.
        clock: The clock that the base runs on. Its counterpart lives on it too.
        is_held: Whether the base holds its device now, seen from outside of the driver.
        motion: How the robot really moves now: speed forwards in m/s, rate of turn in rad/s, positive to the left.
        faults: What can go wrong with the connection, by the names in `FAULTS`: functions that begin it with True and
            end it with False. Those that the counterpart cannot have are left out.
    """

    base: MobileBase
    clock: ManualClock
    is_held: Callable[[], bool]
    motion: Callable[[], tuple[float, float]]
    faults: Mapping[str, Callable[[bool], None]] = field(default_factory=dict)

    def twist(self, linear_mps: float, angular_radps: float) -> TwistCommand:
        """Return a command on a frame of now."""
        return TwistCommand(
            output="base",
            linear_mps=linear_mps,
            angular_radps=angular_radps,
            captured_at_s=self.clock.now_s(),
        )

    def drive(self, linear_mps: float, angular_radps: float, seconds: float = 1.0) -> TwistCommand:
        """Command a motion again and again as the loop does, and return what was applied last."""
        for _ in range(math.ceil(seconds / LOOP_S)):
            applied = self.base.apply(self.twist(linear_mps, angular_radps))
            self.pass_time(LOOP_S)
        return applied

    def pass_time(self, seconds: float) -> None:
        """Let time pass with the driver's ticks."""
        for _ in range(math.ceil(seconds / TICK_S)):
            self.clock.advance_s(TICK_S)
            self.base.tick(self.clock.now_s())

    def stands(self) -> bool:
        """Return whether the robot really stands."""
        linear_mps, angular_radps = self.motion()
        return abs(linear_mps) < STANDING_MPS and abs(angular_radps) < STANDING_RADPS


class BaseContract:
    """The tests. The base must be able to drive at 0.2 m/s and to turn at 1 rad/s, and not to drive at 20 m/s."""

    @pytest.fixture
    def stand(self) -> BaseStand:
        """Return a base that is not opened. To be given by the subclass."""
        raise NotImplementedError

    @pytest.fixture
    def opened(self, stand: BaseStand) -> Iterator[BaseStand]:
        """Open the base, and close it at the end."""
        stand.base.open()
        yield stand
        stand.base.close()

    def test_the_constructor_touches_no_hardware(self, stand: BaseStand) -> None:
        assert not stand.is_held()

    def test_opening_takes_the_device_and_closing_gives_it_back(self, stand: BaseStand) -> None:
        stand.base.open()
        assert stand.is_held()
        stand.base.close()
        assert not stand.is_held()

    def test_it_opens_standing(self, opened: BaseStand) -> None:
        assert opened.stands()
        opened.pass_time(1.0)
        assert opened.stands()

    @pytest.mark.parametrize("motion", [(0.2, 0.0), (-0.2, 0.0), (0.0, 1.0), (0.0, -1.0), (0.2, -0.5)])
    def test_it_moves_as_it_says_and_about_as_it_was_told(self, opened: BaseStand, motion: tuple[float, float]) -> None:
        applied = opened.drive(*motion)
        assert (applied.linear_mps, applied.angular_radps) == pytest.approx(motion, rel=0.05, abs=0.02)
        assert opened.motion() == pytest.approx((applied.linear_mps, applied.angular_radps), rel=0.02, abs=1e-3)

    def test_what_was_applied_names_the_same_output_and_frame(self, opened: BaseStand) -> None:
        command = opened.twist(0.2, 0.0)
        applied = opened.base.apply(command)
        assert (applied.output, applied.captured_at_s) == (command.output, command.captured_at_s)

    def test_too_fast_is_slowed_down_and_the_answer_says_so(self, opened: BaseStand) -> None:
        applied = opened.drive(20.0, 0.0)
        assert 0.2 <= applied.linear_mps < 20.0
        assert opened.motion()[0] == pytest.approx(applied.linear_mps, rel=0.02)

    def test_stop_stands_still(self, opened: BaseStand) -> None:
        opened.drive(0.2, 1.0)
        assert not opened.stands()
        opened.base.stop()
        opened.pass_time(1.0)
        assert opened.stands()

    def test_a_command_of_zero_stands_still(self, opened: BaseStand) -> None:
        opened.drive(0.2, 1.0)
        applied = opened.base.apply(TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0))
        assert (applied.linear_mps, applied.angular_radps) == (0.0, 0.0)
        opened.pass_time(1.0)
        assert opened.stands()

    def test_it_drives_again_after_a_stop(self, opened: BaseStand) -> None:
        opened.drive(0.2, 0.0)
        opened.base.stop()
        opened.pass_time(1.0)
        opened.drive(0.2, 0.0)
        assert opened.motion()[0] == pytest.approx(0.2, rel=0.05)

    def test_closing_stops_first(self, stand: BaseStand) -> None:
        stand.base.open()
        stand.drive(0.2, 0.0)
        assert not stand.stands()
        stand.base.close()
        stand.clock.advance_s(1.0)
        assert stand.stands()

    def test_closing_again_does_nothing(self, stand: BaseStand) -> None:
        stand.base.close()
        stand.base.open()
        stand.base.close()
        stand.base.close()

    def test_it_can_be_opened_again(self, stand: BaseStand) -> None:
        stand.base.open()
        stand.base.close()
        stand.base.open()
        stand.drive(0.2, 0.0)
        assert stand.motion()[0] == pytest.approx(0.2, rel=0.05)
        stand.base.close()

    def test_using_it_before_it_is_opened_is_an_error(self, stand: BaseStand) -> None:
        self._refuses_use(stand)

    def test_using_it_after_it_was_closed_is_an_error(self, stand: BaseStand) -> None:
        stand.base.open()
        stand.base.close()
        self._refuses_use(stand)

    def test_stopping_it_when_closed_does_nothing(self, stand: BaseStand) -> None:
        stand.base.stop()
        assert not stand.is_held()
        stand.base.open()
        stand.base.close()
        stand.base.stop()
        assert not stand.is_held()

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_a_speed_that_is_no_number_cannot_be_commanded(self, opened: BaseStand, value: float) -> None:
        with pytest.raises(CommandRangeError):
            opened.base.apply(opened.twist(value, 0.0))
        with pytest.raises(CommandRangeError):
            opened.base.apply(opened.twist(0.0, value))

    @pytest.fixture(params=FAULTS)
    def fault(self, request: pytest.FixtureRequest, stand: BaseStand) -> Iterator[Callable[[bool], None]]:
        """Return each fault that the base's counterpart can have; the base is open, and closed at the end."""
        if request.param not in stand.faults:
            pytest.skip("its counterpart cannot have this fault")
        stand.base.open()
        yield stand.faults[request.param]
        with suppress(LinkLostError):
            stand.base.close()

    def test_a_lost_connection_is_noticed_while_driving(self, stand: BaseStand, fault: Callable[[bool], None]) -> None:
        stand.drive(0.2, 0.0)
        fault(True)
        with pytest.raises(LinkLostError):
            stand.drive(0.2, 0.0, LOST_WITHIN_S)

    def test_a_base_with_a_lost_connection_is_released_all_the_same(
        self, stand: BaseStand, fault: Callable[[bool], None]
    ) -> None:
        fault(True)
        with suppress(LinkLostError):
            stand.drive(0.2, 0.0, LOST_WITHIN_S)
        with suppress(LinkLostError):
            stand.base.close()
        assert not stand.is_held()
        with pytest.raises(DeviceOpenError):
            stand.base.open()
        assert not stand.is_held()

    def test_a_base_that_answers_again_opens_standing_and_drives(
        self, stand: BaseStand, fault: Callable[[bool], None]
    ) -> None:
        stand.drive(0.2, 0.0)
        fault(True)
        with suppress(LinkLostError):
            stand.drive(0.2, 0.0, LOST_WITHIN_S)
        with suppress(LinkLostError):
            stand.base.close()
        fault(False)
        stand.clock.advance_s(TICK_S)
        stand.base.open()
        stand.pass_time(1.0)
        assert stand.stands()
        stand.drive(0.2, 0.0)
        assert stand.motion()[0] == pytest.approx(0.2, rel=0.05)

    @staticmethod
    def _refuses_use(stand: BaseStand) -> None:
        with pytest.raises(DeviceClosedError):
            stand.base.apply(stand.twist(0.1, 0.0))
        with pytest.raises(DeviceClosedError):
            stand.base.tick(stand.clock.now_s())
