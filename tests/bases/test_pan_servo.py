"""A camera on a servo: the pulses that it gets, where it must stand, and what is refused."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.bases.pan_servo import CENTRES_S, PULSES_END_AFTER_S, PanServoBase, PanServoOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.errors import CommandRangeError, DeviceClosedError, LinkLostError
from stadimeter.simulation.motors import EmulatedPca9685, EmulatedPca9685Options
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case

CHANNEL, TILT_CHANNEL = 3, 9
TILT = {"channel": TILT_CHANNEL, "up": "40 deg", "down": "20 deg", "up_pulse": "1 ms", "down_pulse": "2 ms"}


def options(**changed: object) -> PanServoOptions:
    return PanServoOptions.model_validate({"port": "emulated-pca9685", "channel": CHANNEL, **changed})


class Bench:
    """A servo on an emulated chip."""

    def __init__(self, **changed: object) -> None:
        self.clock = ManualClock(start_s=50.0)
        context = DriverContext(name="base", clock=self.clock)
        self.world = context.share("world", lambda: World(WorldOptions(), self.clock))
        self.bus: EmulatedPca9685 = EmulatedPca9685Options.device(context)
        self.base = PanServoBase(options(**changed), context)
        self.base.open()

    def turn(self, radps: float, seconds: float) -> list[float]:
        """Command a rate 25 times a second, with ticks between; return the rates that were sent."""
        sent = []
        for _ in range(round(seconds * 25)):
            command = TwistCommand(output="base", linear_mps=0.2, angular_radps=radps, captured_at_s=0.0)
            sent.append(self.base.apply(command))
            self.wait(0.04)
        assert {each.linear_mps for each in sent} == {0.0}
        return [each.angular_radps for each in sent]

    def tilt(self, radps: float, seconds: float) -> list[float]:
        """Command a tilt rate likewise, without a turn; return the rates that were sent."""
        sent = []
        for _ in range(round(seconds * 25)):
            command = TwistCommand(
                output="base", linear_mps=0.0, angular_radps=0.0, tilt_radps=radps, captured_at_s=0.0
            )
            sent.append(self.base.apply(command).tilt_radps)
            self.wait(0.04)
        return sent

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            self.clock.advance_s(0.02)
            self.base.tick(self.clock.now_s())

    @property
    def pulse_s(self) -> float:
        return self.bus.chip.pulse_s(CHANNEL)

    @property
    def tilt_pulse_s(self) -> float:
        return self.bus.chip.pulse_s(TILT_CHANNEL)

    @property
    def heading_rad(self) -> float:
        return self.world.robot.pose.heading_rad

    @property
    def tilt_rad(self) -> float:
        return self.world.tilt_joint.pose.heading_rad


def test_opening_turns_nothing_and_the_first_turn_begins_straight_ahead() -> None:
    bench = Bench()
    bench.wait(1.0)
    assert bench.pulse_s == 0.0
    sent = bench.turn(0.5, CENTRES_S - 0.1)
    assert set(sent) == {0.0}
    assert bench.pulse_s == pytest.approx(0.0015, abs=5e-6)
    bench.turn(0.5, 1.1)
    assert bench.heading_rad == pytest.approx(0.5, abs=0.06)


def test_it_turns_as_commanded_and_its_pulses_end_a_while_after_it_stands() -> None:
    bench = Bench()
    bench.turn(-0.5, CENTRES_S + 1.0)
    bench.turn(0.0, 0.2)
    assert bench.heading_rad == pytest.approx(-0.5, abs=0.04)
    assert bench.pulse_s == pytest.approx(0.0015 - 0.5 / (math.pi / 2) * 0.001, abs=2e-5)
    bench.turn(0.0, PULSES_END_AFTER_S)
    assert bench.pulse_s == 0.0
    stood_rad = bench.heading_rad
    bench.turn(0.5, 0.5)
    assert bench.heading_rad - stood_rad == pytest.approx(0.25, abs=0.05), "it goes on from where it was"


def test_it_reports_its_angle_as_wheels_that_turn_would() -> None:
    bench = Bench()
    assert bench.base.report() is None
    bench.turn(0.4, CENTRES_S + 1.0)
    report = bench.base.report()
    assert report is not None
    assert report.left_m is not None
    assert report.right_m == pytest.approx(-report.left_m)
    assert report.right_m == pytest.approx(0.3 * bench.heading_rad, abs=0.02)


def test_a_stop_ends_the_pulses_at_once_and_one_on_the_way_to_the_middle_begins_there_anew() -> None:
    bench = Bench()
    bench.turn(0.5, 0.2)
    bench.base.stop()
    assert bench.pulse_s == 0.0
    bench.wait(1.0)
    assert bench.pulse_s == 0.0
    assert set(bench.turn(0.5, CENTRES_S - 0.1)) == {0.0}
    bench.turn(0.5, 1.0)
    bench.base.stop()
    stood_rad = bench.heading_rad
    bench.wait(1.0)
    assert bench.heading_rad == pytest.approx(stood_rad, abs=0.03)
    assert set(bench.turn(0.5, 0.1)) == {0.5}


@pytest.mark.long
@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.sampled_from([0.05, 0.4, 2.0])), max_size=8))
def test_whatever_is_commanded_it_stays_within_its_travel_and_says_so_at_its_ends(
    turns: list[tuple[float, float]],
) -> None:
    bench = Bench(left="30 deg", right="60 deg", left_pulse="1 ms", right_pulse="2 ms")
    for radps, seconds in turns:
        *_, sent = bench.turn(radps, seconds)
        assert sent in {0.0, radps}
        assert bench.pulse_s == 0.0 or 0.0009 < bench.pulse_s < 0.0021
        assert -math.radians(60) - 0.02 <= bench.heading_rad <= math.radians(30) + 0.02
    assert set(bench.turn(1.0, 4.0)[-5:]) == {0.0}
    assert bench.heading_rad == pytest.approx(math.radians(30), abs=0.02)


def test_a_chip_that_is_gone_is_a_lost_link_and_one_that_is_closed_an_error() -> None:
    bench = Bench()
    bench.turn(0.5, 1.0)
    bench.world.faults.base_unplugged = True
    with pytest.raises(LinkLostError):
        bench.turn(0.5, 0.2)
    bench.world.faults.base_unplugged = False
    bench.base.close()
    bench.base.close()
    assert bench.pulse_s == 0.0
    with pytest.raises(DeviceClosedError):
        bench.turn(0.5, 0.1)


def test_a_servo_that_tilts_does_so_as_commanded_and_the_other_holds_its_angle_meanwhile() -> None:
    bench = Bench(tilt=TILT)
    bench.turn(0.5, CENTRES_S + 0.5)
    turned_rad = bench.heading_rad
    assert set(bench.tilt(0.4, 1.0)) == {0.4}
    assert bench.tilt_rad == pytest.approx(0.4, abs=0.03)
    assert bench.heading_rad == pytest.approx(turned_rad, abs=0.03)
    assert bench.pulse_s > 0.0
    assert bench.tilt_pulse_s == pytest.approx(0.002 - (0.4 + math.radians(20)) / math.radians(60) * 0.001, abs=2e-5)
    report = bench.base.report()
    assert report is not None
    assert report.camera_tilt_rad == pytest.approx(bench.tilt_rad, abs=0.02)
    bench.tilt(0.0, PULSES_END_AFTER_S + 0.1)
    assert (bench.pulse_s, bench.tilt_pulse_s) == (0.0, 0.0)


def test_a_tilt_alone_begins_with_both_straight_ahead_and_ends_with_its_travel() -> None:
    bench = Bench(tilt=TILT)
    assert set(bench.tilt(1.0, CENTRES_S - 0.1)) == {0.0}
    assert bench.pulse_s == pytest.approx(0.0015, abs=5e-6)
    assert bench.tilt(1.0, 2.0)[-1] == 0.0
    assert bench.tilt_rad == pytest.approx(math.radians(40), abs=0.02)
    assert bench.tilt(-1.0, 3.0)[-1] == 0.0
    assert bench.tilt_rad == pytest.approx(math.radians(-20), abs=0.02)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_tilt_that_is_no_number_or_has_no_frame_cannot_be_commanded(value: float) -> None:
    with pytest.raises(CommandRangeError):
        TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0, tilt_radps=value, captured_at_s=0.0)
    with pytest.raises(CommandRangeError):
        TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0, tilt_radps=0.1)


def test_a_stop_and_the_write_from_outside_end_the_pulses_of_both() -> None:
    bench = Bench(tilt=TILT)
    bench.turn(0.5, CENTRES_S + 0.5)
    bench.tilt(0.5, 0.5)
    assert min(bench.pulse_s, bench.tilt_pulse_s) > 0.0
    bench.base.stop()
    assert (bench.pulse_s, bench.tilt_pulse_s) == (0.0, 0.0)
    bench.tilt(0.5, 0.2)
    stop = options(port="/dev/i2c-1", tilt=TILT).i2c_stop()
    assert stop is not None
    assert min(bench.pulse_s, bench.tilt_pulse_s) > 0.0
    for each in stop.writes:  # as the watchdog process and safe-outputs do
        bench.bus.write(each)
    assert (bench.pulse_s, bench.tilt_pulse_s) == (0.0, 0.0)


def test_after_a_pause_it_goes_on_from_where_it_stood() -> None:
    bench = Bench()
    bench.turn(0.5, CENTRES_S + 0.5)
    stood_rad = bench.heading_rad
    bench.clock.advance_s(0.6)
    bench.wait(0.02)
    assert bench.heading_rad == pytest.approx(stood_rad, abs=0.03), "not 0.3 rad further at once"


def test_once_it_is_opened_again_it_goes_on_from_where_it_is() -> None:
    bench = Bench(tilt=TILT)
    bench.turn(0.5, CENTRES_S + 1.0)
    bench.tilt(0.5, 0.5)
    bench.world.faults.base_unplugged = True
    with pytest.raises(LinkLostError):
        bench.turn(0.5, 0.2)
    with pytest.raises(LinkLostError):
        bench.base.close()
    bench.world.faults.base_unplugged = False
    bench.base.open()
    assert bench.pulse_s == 0.0
    stood_rad, tilted_rad = bench.heading_rad, bench.tilt_rad
    assert set(bench.turn(-0.1, 0.2)) == {-0.1}
    assert bench.heading_rad == pytest.approx(stood_rad, abs=0.04)
    assert bench.tilt_rad == pytest.approx(tilted_rad, abs=0.02)


@each_case(
    "table",
    [
        {"left": "0 deg"},
        {"right": "100 deg"},
        {"left": "nan"},
        {"left_pulse": "1 ms"},
        {"left_pulse": "5 ms"},
        {"channel": 16},
        {"port": "/dev/ttyUSB0"},
        {"tilt": {"channel": CHANNEL}},
        {"tilt": {"up": "61 deg"}},
        {"tilt": {"down": "0 deg"}},
        {"tilt": {"up": "nan"}},
        {"tilt": {"up_pulse": "1 ms"}},
        {"tilt": {"down_pulse": "5 ms"}},
        {"tilt": {"left": "40 deg"}},
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        options(**table)
