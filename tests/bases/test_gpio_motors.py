"""Two motors on GPIO pins: which pin has which level, when; what is refused; and what makes them safe from outside."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest
from pydantic import ValidationError

from stadimeter.app.service import safe_lines
from stadimeter.bases.gpio_motors import GpioMotorsBase, GpioMotorsOptions
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceOpenError, LinkLostError
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case
from support.pins import WatchedPins

LEFT = {"forward": 17, "backward": 27, "pwm": 12}
RIGHT = {"forward": 23, "backward": 24, "pwm": 13}
PINS = (17, 27, 12, 23, 24, 13, 25)


def options(**changed: object) -> GpioMotorsOptions:
    table = {"left": LEFT, "right": RIGHT, "track_width": "20 cm", "max_wheel_speed": "0.8 m/s", "minimum_duty": 0.2}
    return GpioMotorsOptions.model_validate({**table, **changed})


class Bench:
    """A base on pins in memory."""

    def __init__(self, **changed: object) -> None:
        self.clock = ManualClock()
        self.context = DriverContext(name="base", clock=self.clock)
        self.pins = WatchedPins(self.context)
        self.base = GpioMotorsBase(options(**changed), self.context)
        self.base.open()

    def drive(self, linear_mps: float, angular_radps: float = 0.0) -> tuple[float, float]:
        sent = self.base.apply(
            TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)
        )
        return (sent.linear_mps, sent.angular_radps)

    def levels(self, *pins: int) -> list[float]:
        return [self.pins.state(pin) for pin in pins]


def test_the_inputs_choose_the_direction_and_the_third_pin_the_strength() -> None:
    bench = Bench()
    assert bench.drive(0.4) == (pytest.approx(0.4), 0.0)
    assert bench.levels(17, 27, 12, 23, 24, 13) == [1.0, 0.0, 0.6, 1.0, 0.0, 0.6]
    bench.drive(-0.8)
    assert bench.levels(17, 27, 12, 23, 24, 13) == [0.0, 1.0, 1.0, 0.0, 1.0, 1.0]


def test_what_is_reported_is_what_whole_percents_make_of_it() -> None:
    """80 steps of a percent lead from the minimum duty to 0.8 m/s: 1 cm/s each."""
    bench = Bench()
    assert bench.drive(0.2049)[0] == pytest.approx(0.20)
    assert bench.drive(0.2051)[0] == pytest.approx(0.21)
    assert bench.drive(0.004) == (0.0, 0.0)
    assert bench.drive(0.006)[0] == pytest.approx(0.01)
    assert bench.levels(12) == [0.21]


def test_lgpio_is_given_exactly_the_percent_that_is_reported(lgpio: Callable[[], ModuleType]) -> None:
    context = DriverContext(name="base", clock=ManualClock())
    base = GpioMotorsBase(options(), context)
    base.open()
    for percent in range(21, 101):
        speed_mps = (percent - 20) * 0.01
        sent = base.apply(TwistCommand(output="base", linear_mps=speed_mps, angular_radps=0.0, captured_at_s=0.0))
        assert lgpio().pulses[12] == (100.0, percent)
        assert sent.linear_mps == pytest.approx(speed_mps)
    base.close()
    context.shared.closers.pop()()


@pytest.mark.parametrize(
    ("changed", "levels"),
    [
        ({"swap_sides": True}, [0.6, 0.0]),
        ({"invert_left": True}, [0.0, 0.6]),
        ({"swap_sides": True, "invert_right": True}, [0.0, 0.0]),
    ],
)
def test_sides_and_signs_are_those_of_other_bases(changed: dict[str, object], levels: list[float]) -> None:
    """The right wheel alone turns forwards."""
    two = {"left": {"forward": 17, "backward": 27}, "right": {"forward": 23, "backward": 24}}
    bench = Bench(**two, **changed)
    bench.drive(0.2, 2.0)
    assert bench.levels(17 if changed.get("swap_sides") else 24, 23) in (levels, levels[::-1])


def test_it_brakes_and_then_every_pin_is_low() -> None:
    bench = Bench(enable=25, brake="200 ms")
    assert bench.levels(*PINS) == [0.0] * 7
    bench.drive(0.4)
    bench.base.stop()
    assert bench.levels(*PINS) == [1.0] * 7
    bench.clock.advance_s(0.19)
    bench.base.tick(bench.clock.now_s())
    assert bench.levels(*PINS) == [1.0] * 7
    bench.drive(0.0)  # standing is commanded again and again, and does not prolong the braking
    bench.clock.advance_s(0.01)
    bench.base.tick(bench.clock.now_s())
    assert bench.levels(*PINS) == [0.0] * 7


def test_without_a_brake_a_stop_makes_every_pin_low_at_once() -> None:
    bench = Bench(enable=25, brake="0 s")
    bench.drive(0.4)
    bench.base.stop()
    assert bench.levels(*PINS) == [0.0] * 7


def test_a_motor_with_a_direction_pin_is_not_driven_to_brake_it() -> None:
    bench = Bench(left={"direction": 17, "pwm": 12}, right={"direction": 23, "pwm": 13})
    bench.drive(0.4)
    bench.base.stop()
    assert bench.levels(17, 12, 23, 13) == [0.0] * 4


@each_case("dead", PINS)
@each_case("begins", ["drive", "stop", "close"])
def test_when_one_pin_fails_no_other_stays_high(dead: int, begins: str) -> None:
    bench = Bench(enable=25)
    bench.drive(0.4)
    bench.pins.fail(dead, begins=True)
    with pytest.raises(LinkLostError, match=f"GPIO{dead}"):
        bench.drive(-0.5) if begins == "drive" else getattr(bench.base, begins)()
    if begins == "drive":  # as the runtime does after an error
        with pytest.raises(LinkLostError):
            bench.base.close()
    assert [bench.pins.state(pin) for pin in PINS if pin != dead] == [0.0] * 6


def test_a_stop_from_within_a_command_is_not_undone_by_what_was_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal handler stops while a command is being written; the safe command that follows writes everything."""
    bench = Bench(brake="0 s")
    write = bench.base._pins[13].rewrite
    stops = iter([bench.base.stop])

    def interrupted(percent: int) -> None:
        if percent:
            next(stops, lambda: None)()
        write(percent)

    monkeypatch.setattr(bench.base._pins[13], "rewrite", interrupted)
    bench.drive(0.4)
    assert bench.levels(13) == [0.6]  # what LeasedOutput then takes back
    bench.base.apply(TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0))
    assert bench.levels(*PINS[:6]) == [0.0] * 6


def test_a_pin_that_another_program_holds_leaves_none_taken() -> None:
    context = DriverContext(name="base", clock=ManualClock())
    pins = WatchedPins(context)
    pins.occupy(23, begins=True)
    base = GpioMotorsBase(options(), context)
    with pytest.raises(DeviceOpenError, match="GPIO23"):
        base.open()
    assert not base.is_open
    assert not pins.is_held()


@each_case(
    ("changed", "words"),
    [
        ({"left": {"forward": 17}}, "forward is named; a motor needs"),
        ({"left": {}}, "nothing is named"),
        ({"left": {"direction": 17, "backward": 27, "pwm": 12}}, "direction and pwm"),
        ({"left": {"forward": 40, "backward": 27}}, "is not a pin"),
        ({"max_wheel_speed": "0 m/s"}, "measure their speed at full duty"),
        ({"track_width": "0 cm"}, "not a length above zero"),
        ({"minimum_duty": 1.0}, "less than or equal to 0.9"),
        ({"frequency": "1 Hz"}, "20"),
    ],
)
def test_what_cannot_be_meant_is_refused(changed: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        options(**changed)


def test_from_outside_it_is_made_safe_by_low_pins() -> None:
    choice = DriverChoice(name="base", driver="gpio-motors", options=options(enable=25))
    assert sorted(safe_lines(choice)) == sorted(f"pin {pin} low" for pin in PINS)


def test_pins_keep_their_level_so_nothing_stops_it_by_itself() -> None:
    assert options().stops_by_itself_after_s() == float("inf")
