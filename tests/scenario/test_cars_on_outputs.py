"""Cars whose motors hang on pins, or on the channels of a chip: they follow, and the *wheels* stop."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
(PRACTICE,) = re.findall(r"<!-- file: practice.toml -->\n```toml\n(.*?)```", PAGE, re.DOTALL)
PINS = re.compile(r'^driver = "gpio-motors"\nport = .*\nleft = .*\nright = .*\n', re.MULTILINE)
# What differs between cars is behind their decisions: the first looks at pictures that are drawn, the others need none.
UNDRAWN = re.sub(
    r'detector = "ball"\n(?:\w+ = .*\n)+', 'detector = "ideal"\n', PRACTICE.replace("\n\n", "\nrender = false\n\n", 1)
)
CARS = {
    "pins": PRACTICE,
    "coasting": UNDRAWN.replace("[rules.follow]", 'brake = "0 s"\n\n[rules.follow]'),
    "chip": PINS.sub('driver = "pca9685"\nport = "emulated-pca9685"\nboard = "freenove-4wd"\n', UNDRAWN),
}

# Of the wheel: below this it stands. It is a hundredth of the speed that it had.
STANDS_MPS = 0.003


class Car:
    """A run, and for how long its wheels turned after something went wrong."""

    def __init__(self, scenario: Callable[..., Any], text: str) -> None:
        self.run = scenario(text=text)
        self.stood_s: float | None = None
        self._wrong_s = 0.0
        self.run.loop.parts.clock.call_every(0.005, self._look)

    def begin_at(self, time_s: float, fault: str) -> None:
        def begin() -> None:
            self._wrong_s = self.run.world.now_s
            setattr(self.run.world.faults, fault, True)

        self.run.at(time_s, begin)

    def _look(self, now_s: float) -> None:
        stands = max(map(abs, self.run.world.robot.wheels_mps)) < STANDS_MPS
        if not self._wrong_s or not stands:
            self.stood_s = None
        elif self.stood_s is None:
            self.stood_s = now_s - self._wrong_s


@pytest.mark.long
@pytest.mark.parametrize("car", CARS)
def test_the_car_drives_to_one_metre_from_the_ball_and_faces_it(scenario: Callable[..., Any], car: str) -> None:
    run = scenario(text=CARS[car]).run(15)
    track = run.records[-1].decision.tracks[0]
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert abs(track.bearing_rad) < 0.06
    assert max(map(abs, run.world.robot.wheels_mps)) < STANDS_MPS


@pytest.mark.long
@pytest.mark.parametrize(
    ("car", "fault"),
    [("pins", "camera_blocked"), ("coasting", "target_hidden"), ("chip", "camera_frozen"), ("chip", "target_hidden")],
)
def test_the_wheels_of_a_car_stand_within_half_a_second_after_something_went_wrong(
    scenario: Callable[..., Any], car: str, fault: str
) -> None:
    stays = CARS[car].replace('max_speed = "0.3 m/s" }', 'max_speed = "0.3 m/s", search = "off" }')
    tried = Car(scenario, stays)
    tried.begin_at(2.0, fault)
    tried.run.run(4.0)
    assert min(tried.run.base_speeds(1.5, 2.0)) > 0.1, "it drove"
    assert tried.stood_s is not None, "the wheels still turn"
    # Motors that coast roll out with a time constant of 0.15 s, until a hundredth of their speed is left.
    coasting_s = 0.15 * math.log(100) if car == "coasting" else 0.0
    assert tried.stood_s <= 0.5 + coasting_s


def test_a_chip_whose_cable_comes_off_goes_on_until_the_link_is_back_and_is_then_stopped(
    scenario: Callable[..., Any],
) -> None:
    """Nothing can stop it without the cable; what the program does is to notice, and to stop it first of all."""
    tried = Car(scenario, CARS["chip"])
    tried.begin_at(2.0, "base_unplugged")

    def plug_in() -> None:
        assert max(tried.run.world.robot.wheels_mps) > 0.1
        tried.run.world.faults.base_unplugged = False

    tried.run.at(3.0, plug_in)
    tried.run.run(3.5)
    faults = [
        event
        for record in tried.run.records
        for event in record.decision.events
        if event.source == "base" and event.kind == "fault"
    ]
    assert faults[0].at_s - 2.0 <= 0.1
    assert "does not answer" in faults[0].reason
