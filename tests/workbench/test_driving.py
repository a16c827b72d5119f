"""Learning which motor drives which wheel: what is concluded, that the motors stand afterwards, and what is written."""

from __future__ import annotations

import itertools
import json
import signal
from pathlib import Path
from typing import Any

import pytest
from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.bases import gpio_motors
from stadimeter.cli.drive import DUTIES, WIRING, Turned, base_with_wheels, open_wheels, wiring_of, with_base_options
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, DriverError
from stadimeter.testing.rig import ManualClock
from support.command_line import Typed, typed

TEXT = """
[camera]
driver = "opencv"
device = 0
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"
[base]
driver = "gpio-motors"
left = { forward = 17, backward = 27, pwm = 12 }
right = { forward = 16, backward = 20, pwm = 13 }  # as soldered
track_width = "15 cm"
max_wheel_speed = "0.6 m/s"
"""

PINS = (17, 27, 12, 16, 20, 13)


@pytest.fixture
def pins(monkeypatch: pytest.MonkeyPatch) -> MockFactory:
    factory = MockFactory(pin_class=MockPWMPin)
    monkeypatch.setattr(gpio_motors, "shared_pin_factory", lambda _context: factory)
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "mock")
    return factory


def configured(folder: Path, text: str = TEXT) -> Configuration:
    file = folder / "car.toml"
    file.write_text(text)
    return load_configuration(file)


def levels(pins: MockFactory) -> list[float]:
    return [float(pins.pin(number).state) for number in PINS]


class WatchedClock(ManualClock):
    """A clock to step that notes the pins' levels while somebody sleeps, and may bring a signal then."""

    def __init__(self, pins: MockFactory, comes: signal.Signals | None = None) -> None:
        super().__init__()
        self.seen: list[list[float]] = []
        self._pins = pins
        self._comes = comes

    def sleep_until_s(self, until_s: float) -> None:
        self.seen.append(levels(self._pins))
        super().sleep_until_s(until_s)
        if self._comes is not None:
            signal.raise_signal(self._comes)


@pytest.mark.parametrize(
    "wiring", [dict(zip(WIRING, each, strict=True)) for each in itertools.product([False, True], repeat=3)]
)
def test_what_a_person_sees_tells_how_any_robot_is_wired(
    tmp_path: Path, pins: MockFactory, wiring: dict[str, bool]
) -> None:
    """The world is a base that says the truth of itself: which pins then turn which wheel forwards is what is seen."""
    configuration = configured(tmp_path)
    turns: dict[bool, list[float]] = {}
    for is_right in (False, True):
        clock = WatchedClock(pins)
        with open_wheels(configuration, wiring, clock, print) as wheels:
            wheels.turn(0.5 * (not is_right), 0.5 * is_right, 0.2)
        turns[is_right] = clock.seen[0]
    answers = []
    for left, right in ((0.5, 0.0), (0.0, 0.5)):
        clock = WatchedClock(pins)
        with open_wheels(configuration, {}, clock, print) as wheels:
            wheels.turn(left, right, 0.2)
        (seen,) = (
            Turned(is_right=is_right, is_backwards=forwards != clock.seen[0])
            for is_right, forwards in turns.items()
            if (forwards[2] > 0) == (clock.seen[0][2] > 0)  # by the strength of the left motor
        )
        answers.append(seen)
    assert wiring_of(*answers) == wiring


def test_a_duty_is_what_the_pins_get_and_they_are_low_after_it(tmp_path: Path, pins: MockFactory) -> None:
    clock = WatchedClock(pins)
    with open_wheels(configured(tmp_path), {}, clock, print) as wheels:
        assert wheels.strengths == DUTIES
        wheels.turn(0.35, 0.0, 1.0)
        assert {tuple(each) for each in clock.seen} == {(1.0, 0.0, 0.35, 0.0, 0.0, 0.0)}
        clock.advance_s(1.0)  # the motors brake for a moment
        assert levels(pins) == [0.0] * 6


def test_a_program_that_hangs_drives_no_further_than_the_lease(tmp_path: Path, pins: MockFactory) -> None:
    clock = ManualClock()
    with open_wheels(configured(tmp_path), {}, clock, print) as wheels:
        begun = pytest.MonkeyPatch()
        begun.setattr(clock, "sleep_until_s", lambda _until_s: (_ for _ in ()).throw(TimeoutError))
        with pytest.raises(TimeoutError):
            wheels.turn(0.35, 0.35, 1.0)
        begun.undo()
        assert levels(pins)[0] == 1.0
        clock.advance_s(2.0)
        assert levels(pins) == [0.0] * 6


@pytest.mark.parametrize("comes", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_motors_before_anything_else(
    tmp_path: Path, pins: MockFactory, comes: signal.Signals
) -> None:
    configuration = configured(tmp_path)
    with pytest.raises(KeyboardInterrupt), open_wheels(configuration, {}, WatchedClock(pins, comes), print) as wheels:
        wheels.turn(0.35, 0.35, 1.0)
    assert not any(pins.pin(number).function == "output" and pins.pin(number).state for number in PINS)


def test_pins_that_another_program_holds_are_named(tmp_path: Path, pins: MockFactory) -> None:
    holder = MockFactory()
    pins.reserve_pins(holder, 17)
    with pytest.raises(DriverError, match="17"), open_wheels(configured(tmp_path), {}, ManualClock(), print):
        pass


def test_only_what_differs_is_written_and_the_rest_of_the_file_stays(tmp_path: Path) -> None:
    configuration = configured(tmp_path)
    found = {"swap_sides": True, "invert_left": False, "invert_right": False, "minimum_duty": 0.25}
    after = with_base_options(configuration, TEXT, found)
    assert sorted(set(after.splitlines()) - set(TEXT.splitlines())) == ["swap_sides = true"]
    assert "# as soldered" in after
    assert load_configuration(configured(tmp_path, after).path).base.options.swap_sides  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ("", "there is no base"),
        ('[base]\ndriver = "ros2-rosbridge"\nurl = "ws://robot:9090"\n', "no two motors that could be tried"),
    ],
)
def test_a_base_without_wheels_of_its_own_is_refused(tmp_path: Path, base: str, words: str) -> None:
    configuration = configured(tmp_path, TEXT.partition("[base]")[0] + base)
    with pytest.raises(ConfigError, match=words):
        base_with_wheels(configuration)


def answered(folder: Path, *lines: str, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...] = ()) -> Typed:
    """Run the command with these answers, on a clock that goes on by itself."""

    monkeypatch.setattr("stadimeter.cli.drive.MonotonicClock", ManualClock)
    return typed("drive", folder / "car.toml", *options, answers="".join(f"{line}\n" for line in lines))


def test_the_command_writes_what_the_answers_mean(tmp_path: Path, pins: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    configured(tmp_path)
    least = ["", "n", "", "n", "", "n", "", "y"]
    speed = ["y", "", "far", "0.4 m", "", "1.8 m"]
    told = answered(tmp_path, "y", "", "n", "", "rf", "", "lb", "y", *least, *speed, "y", monkeypatch=monkeypatch)
    assert told.returncode == 0, told
    assert "The motor that car.toml calls left turns forwards" in told.stdout
    options: Any = load_configuration(tmp_path / "car.toml").base.options  # type: ignore[union-attr]
    assert (options.swap_sides, options.invert_left, options.invert_right) == (True, True, False)
    assert (options.minimum_duty, options.max_wheel_speed) == (0.15, 0.7)
    (kept,) = (tmp_path / "versions").rglob("car.toml")
    assert kept.read_text() == TEXT


def test_json_prints_what_was_found_and_nothing_else(
    tmp_path: Path, pins: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    configured(tmp_path)
    answers = ("y", "", "rf", "", "lb", "n", "n", "y")
    told = answered(tmp_path, *answers, monkeypatch=monkeypatch, options=("--json",))
    wiring = {"swap_sides": True, "invert_left": True, "invert_right": False}
    assert json.loads(told.stdout) == {"file": str(tmp_path / "car.toml"), "written": True, **wiring}
    assert "Which wheel turned" in told.stderr


@pytest.mark.parametrize(
    ("answers", "code", "words"),
    [
        (["n"], 2, "nothing was driven"),
        (["y", ""], 1, "nothing was written"),
        (["y", *["", "n"] * 3], 1, "turned nothing"),
        (["y", "", "rf", "", "rb"], 2, "both motors turned the right wheel"),
        (["y", "", "lf", "", "rf", "n", "n"], 0, "nothing is to be changed"),
        (["y", "", "lb", "", "rf", "n", "n", "n"], 0, "nothing was written"),
    ],
)
def test_whoever_leaves_or_says_no_keeps_the_file(
    tmp_path: Path, pins: Any, monkeypatch: pytest.MonkeyPatch, answers: list[str], code: int, words: str
) -> None:
    configured(tmp_path)
    told = answered(tmp_path, *answers, monkeypatch=monkeypatch)
    assert told.returncode == code, told
    assert words in told.stdout + told.stderr
    assert (tmp_path / "car.toml").read_text() == TEXT
