"""Robots follow the ball through real bytes and pins, as well as is said, and stop when they cannot see."""

from __future__ import annotations

import math
import random
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from msgspec import Struct

from stadimeter.app import guard
from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.guard import REST_S, RESTING
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.command import TwistCommand
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import SafetyMode
from support.simulated_run import LENS, SIMULATED_BALL

# A robot that follows a ball in the simulated world, through the whole program, as fast as the computer can.
#
# Nothing here can be late, however busy the computer is: one thread steps the clock, and the emulated board is served
# within these steps, each 10 ms of the run. A pseudo-terminal has what was written ready for the next read, so the
# board answers one service later at most. What judges by real time is the stall watch alone, which stops the wheels
# when the clock has stood still for half a second; it is off here. So each run is the same each time, and a fault is a
# defect.

# A base with wheels that lag by 0.1 s, behind real serial bytes, and one that obeys at once.
BASES = {
    "emulated": """driver = "ros-arduino-bridge"
port = "emulated-ros-arduino-bridge"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
max_wheel_speed = "0.9 m/s"
""",
    "ideal": 'driver = "simulated"\nmax_wheel_speed = "0.9 m/s"\n',
}

FOLLOW = 'distance = "1 m", max_speed = "0.6 m/s", max_reverse_speed = "0.6 m/s", max_turn_rate = "2 rad/s"'
MAX_SPEED_MPS, MAX_TURN_RADPS = 0.6, 2.0

# What is applied is rounded to whole encoder ticks per frame of the sketch: this many m/s of a wheel.
TICK_MPS = 0.004

Path2 = Callable[[float], tuple[float, float]]
"""Where a ball is on the floor, by the time in seconds since the start."""


class Moment(Struct, frozen=True):
    """One cycle: the truth, what the base was told, and what the program knew."""

    at_s: float
    gap_m: float
    bearing_rad: float
    linear_mps: float
    angular_radps: float
    is_tracked: bool
    events: tuple[str, ...]


def configuration(base: str, latency_ms: float, rule: str, most: str) -> str:
    """Return a configuration that follows at 1 m, with frames that are some time old."""
    start = SIMULATED_BALL.replace('rate = "30 Hz"', f'rate = "30 Hz"\nlatency = "{latency_ms:g} ms"')
    return f"""{start}
[base]
{BASES[base]}max_speed = "{most}"
max_turn_rate = "{MAX_TURN_RADPS} rad/s"
lease = "500 ms"

[safety]
max_frame_age = "350 ms"

[rules.follow]
actuator = "base"
follow = {{ {rule} }}

[world]
camera_height = "12 cm"
ticks_per_metre = 3917.7
"""


def follow(
    folder: Path,
    seconds: float,
    ball: Path2,
    *,
    base: str = "emulated",
    latency_ms: float = 30.0,
    rule: str = FOLLOW,
    most: str = f"{MAX_SPEED_MPS} m/s",
    hidden: Callable[[float], bool] = lambda _: False,
) -> list[Moment]:
    """Follow a ball; return every cycle, with times from the start."""
    path = folder / "following.toml"
    path.write_text(configuration(base, latency_ms, rule, most))
    loop = Loop(build(load_configuration(path), speed=None))
    world = loop.parts.shared.parts["world"]
    start_s = world.now_s
    world.ball.position_m = lambda at_s: (*ball(max(0.0, at_s - start_s)), 0.1)
    world._hand._path = world.ball.position_m
    moments: list[Moment] = []

    def listen(record: CycleRecord, _frame: object) -> None:
        now_s = record.observation.now_s
        world.faults.target_hidden = hidden(now_s - start_s)
        right_m, _, ahead_m = world.target_in_camera(now_s)
        stands = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)  # out of order
        twist = next((each for each in record.applied if each.output == "base"), stands)
        moments.append(
            Moment(
                now_s - start_s,
                world.distance_m(now_s),
                math.atan2(right_m, ahead_m),
                twist.linear_mps,
                twist.angular_radps,
                record.decision.tracks[0].is_valid,
                tuple(event.kind.value for event in record.decision.events),
            )
        )

    loop.listeners.append(listen)
    with patch.object(guard, "STALLED_AFTER_S", math.inf):
        loop.run(Limits(seconds=seconds))
    faults = [each for each in moments if "fault" in each.events]
    assert not faults, f"the base failed, though nothing was wrong with it: {faults}"
    return moments


def stands(x_m: float) -> Path2:
    """Return a ball that stands ahead."""
    return lambda _: (x_m, 0.0)


def walks_away(at_s: float) -> tuple[float, float]:
    """Return a ball that rests for 2 s and then goes away at 0.3 m/s."""
    return 1.0 + 0.3 * max(0.0, at_s - 2.0), 0.0


def sways(at_s: float) -> tuple[float, float]:
    """Return a ball that goes to and fro at up to 0.5 m/s, once in 10 s, and sways sideways by ± 0.3 m."""
    turns = 2 * math.pi * at_s
    return 1.8 - 0.8 * math.cos(0.1 * turns), 0.3 * math.sin(0.17 * turns)


def swaying_path(seed: int) -> Path2:
    """Return a ball that goes to and fro at up to 0.5 m/s, and sways sideways at up to 0.33 m/s.

    Periods, amplitudes and phases are random; it sets off within 3 s. No ball accelerates by more than 0.5 m/s² or so,
    which is what the base can.
    """
    rng = random.Random(seed)  # noqa: S311 - the same path each time
    period_s, phase = rng.uniform(8, 14), rng.uniform(0, 2 * math.pi)
    aside_m, aside_s, aside = rng.uniform(0.2, 0.4), rng.uniform(4.5, 10), rng.uniform(0, 2 * math.pi)
    rate_radps, aside_radps = 2 * math.pi / period_s, min(2 * math.pi / aside_s, 0.33 / aside_m)
    ahead_m = 0.5 / rate_radps

    def at(at_s: float) -> tuple[float, float]:
        into_s = at_s * at_s / 6 if at_s < 3 else at_s - 1.5
        return (
            1.0 + ahead_m * (math.cos(phase) - math.cos(phase + rate_radps * into_s)),
            aside_m * (math.sin(aside + aside_radps * into_s) - math.sin(aside)),
        )

    return at


def random_walk(seed: int, seconds: float) -> Path2:
    """Return a ball that walks about a room of 6 m: from place to place at 0.15 to 0.4 m/s, with rests."""
    rng = random.Random(seed)  # noqa: S311 - the same walk each time
    legs, now_s, place = [], 2.0, (1.2, 0.0)
    while now_s < seconds:
        there = rng.uniform(-3, 3), rng.uniform(-3, 3)
        lasts_s = max(1.0, math.dist(place, there) / rng.uniform(0.15, 0.3))
        legs.append((now_s, lasts_s, place, there))
        now_s, place = now_s + lasts_s + rng.uniform(0, 2), there

    def at(at_s: float) -> tuple[float, float]:
        begin_s, lasts_s, here, there = next(
            (leg for leg in reversed(legs) if leg[0] <= at_s), (0, 1, (1.2, 0.0), (1.2, 0.0))
        )
        share = min(1.0, (at_s - begin_s) / lasts_s)
        share = share * share * (3 - 2 * share)  # at most 1.5 times its mean speed
        return tuple(a + share * (b - a) for a, b in zip(here, there, strict=True))  # type: ignore[return-value]

    return at


def rms(values: list[float]) -> float:
    """Return the root of the mean square."""
    return math.sqrt(sum(value * value for value in values) / len(values))


def out_of_sight_s(moments: list[Moment]) -> list[float]:
    """Return for how long each time the target was not tracked, after it was first."""
    spans, since_s, was_seen = [], None, False
    for moment in moments:
        if moment.is_tracked:
            if since_s is not None:
                spans.append(moment.at_s - since_s)
            since_s, was_seen = None, True
        elif was_seen and since_s is None:
            since_s = moment.at_s
    return spans if since_s is None else [*spans, math.inf]


def is_within_limits(moments: list[Moment]) -> bool:
    """Return whether no command was over a limit, apart from rounding."""
    most_radps = MAX_TURN_RADPS + TICK_MPS / 0.1
    return all(
        abs(each.linear_mps) <= MAX_SPEED_MPS + TICK_MPS and abs(each.angular_radps) <= most_radps for each in moments
    )


# Robots follow the ball through real bytes and pins, as well as is said, and stop when they cannot see.

# The robot follows the ball through real serial bytes, and stops when it cannot see.

STILL_BALL = """
path = [{ at = "0 s", x = "2.2 m", y = "0.5 m" }]
loop = false
"""


def wheels_stand(scenario):
    return all(abs(speed) < 1e-3 for speed in scenario.world.robot.wheels_mps)


@pytest.mark.long
def test_the_robot_drives_to_one_metre_from_the_ball_and_faces_it(scenario):
    run = scenario(STILL_BALL).run(15)
    track = run.records[-1].decision.tracks[0]
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert track.distance_m == pytest.approx(run.world.distance_m(), abs=0.02)
    assert abs(track.bearing_rad) < 0.04
    assert wheels_stand(run)
    assert run.world.robot.ticks[0] > 3000, "the wheels of the emulated base really turned"


def test_hiding_the_ball_stops_the_robot_within_the_coasting_time(scenario):
    run = scenario(STILL_BALL)
    stood = []

    def hide():
        run.world.faults.target_hidden = True

    run.at(1.5, hide)
    run.at(3.0, lambda: stood.append(wheels_stand(run)))
    run.run(3.2)
    assert min(run.base_speeds(1.0, 1.5)) > 0.2
    assert set(run.base_speeds(1.9, 3.2)) == {0.0}
    assert stood == [True]
    assert ("ball", "target_lost") in run.events()


def test_freezing_the_camera_stops_the_robot_within_the_frame_age(scenario):
    run = scenario(STILL_BALL)

    def freeze():
        run.world.faults.camera_frozen = True

    run.at(1.5, freeze)
    run.run(4.0)
    assert set(run.base_speeds(1.75, 4.0)) == {0.0}
    assert wheels_stand(run)
    assert run.records[-1].decision.safety is SafetyMode.STALE
    assert ("camera", "fault") in run.events()


def test_a_camera_that_gives_nothing_at_all_stops_the_robot_as_well(scenario):
    run = scenario(STILL_BALL)

    def block():
        run.world.faults.camera_blocked = True

    run.at(1.5, block)
    run.run(4.0)
    assert set(run.base_speeds(1.85, 4.0)) == {0.0}
    assert wheels_stand(run)


@pytest.mark.long
def test_after_a_fault_the_robot_goes_on_when_it_sees_again(scenario):
    run = scenario(STILL_BALL + 'faults = [{ at = "1 s", for = "1 s", kind = "freeze-camera" }]\n').run(15)
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert [kind for source, kind in run.events() if source == "camera"] == ["fault", "fault_cleared"]


def unplugged(scenario, base=""):
    run = scenario(STILL_BALL, base=base)

    def unplug():
        run.world.faults.base_unplugged = True

    def plug_in():
        run.world.faults.base_unplugged = False

    run.at(1.5, unplug)
    run.at(4.5, plug_in)
    return run


@pytest.mark.long
def test_a_base_that_is_unplugged_stops_by_itself_while_the_rest_goes_on(scenario):
    run = unplugged(scenario).run(4.4)
    assert ("base", "fault") in run.events()
    assert wheels_stand(run)
    motor = [command for command in run.records[-1].applied if command.output == "motor"]
    assert motor, "the motor still gets its commands"
    fault = run.records[-1].observation.output_faults[0]
    assert fault.output == "base"


@pytest.mark.long
def test_a_robot_that_bumps_into_something_stands_until_it_is_free_whatever_its_rules_want(scenario):
    world = STILL_BALL + 'faults = [{ at = "1.5 s", for = "1 s", kind = "press-bumper" }]\n'
    run = scenario(world, is_base_emulated=False).run(15)
    assert min(run.base_speeds(1.0, 1.5)) > 0.2
    assert set(run.base_speeds(1.6, 2.5)) <= {0.0}
    assert [kind for source, kind in run.events() if source == "base"] == ["fault", "fault_cleared"]
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)


@pytest.mark.long
def test_a_base_that_is_plugged_in_again_is_identified_and_rests_before_it_drives_from_standstill(scenario):
    run = unplugged(scenario).run(20)
    events = [event for record in run.records for event in record.decision.events if event.source == "base"]
    assert [event.kind for event in events] == ["fault", "fault", "fault_cleared"]
    identified_s, allowed_s = events[1].at_s, events[2].at_s
    assert events[1].reason == RESTING
    assert 4.5 < identified_s <= allowed_s - REST_S < identified_s + 0.2
    assert run.base_speeds(1.6, allowed_s) == []
    assert run.base_speeds(allowed_s, allowed_s + 0.06)[0] < 0.1, "it sets off from standstill"
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert {record.decision.safety for record in run.records if record.observation.now_s > 1} == {"active"}
    state = initial_state(run.loop.parts.configuration.plan)
    for record in run.records:
        state, decision = decide(state, record.observation)
        assert (decision.commands, decision.events) == (record.decision.commands, record.decision.events), "replayed"


@pytest.mark.long
def test_a_base_that_shall_stay_off_does_so_when_it_is_plugged_in_again(scenario):
    run = unplugged(scenario, base='after_fault = "stay_off"').run(20)
    assert run.base_speeds(1.6, 20) == []
    assert [kind for source, kind in run.events() if source == "base"] == ["fault"]


def test_at_the_end_of_a_run_the_wheels_stand(scenario):
    run = scenario(STILL_BALL).run(1.5)
    before_mps = run.base_speeds(1.4, 1.6)[-1]
    assert before_mps > 0.2
    assert all(0 <= speed_mps < before_mps / 2 for speed_mps in run.world.robot.wheels_mps), "they run down"


# How well a base follows, through the whole program: one with lagging wheels, and one that obeys at once.

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(params=["emulated", "ideal"])
def base(request):
    return request.param


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_a_step_of_half_a_metre_is_settled_within_2_5_s_and_standing_stays_within_two_per_cent(
    base, latency_ms, tmp_path
):
    moments = follow(tmp_path, 12, stands(1.5), base=base, latency_ms=latency_ms)
    assert max((each.at_s for each in moments if abs(each.gap_m - 1) > 0.1), default=0.0) <= 2.5
    assert min(each.gap_m for each in moments) >= 0.95
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 6]) <= 0.02
    assert is_within_limits(moments)


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_behind_a_ball_that_walks_away_it_stays_within_5_cm(base, latency_ms, tmp_path):
    moments = follow(tmp_path, 12, walks_away, base=base, latency_ms=latency_ms)
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 5]) <= 0.05


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_a_ball_that_goes_to_and_fro_and_sways_is_kept_within_10_cm_and_never_at_half_the_distance(
    base, latency_ms, tmp_path
):
    moments = follow(tmp_path, 35, sways, base=base, latency_ms=latency_ms)
    assert rms([each.gap_m - 1 for each in moments if each.at_s > 5]) <= {30: 0.10, 190: 0.11}[latency_ms]
    assert min(each.gap_m for each in moments) > 0.5
    assert is_within_limits(moments)


@pytest.mark.long
@pytest.mark.parametrize("latency_ms", [30, 190])
def test_the_follow_ball_configuration_stays_further_than_half_the_distance_from_a_ball_at_half_a_metre_a_second(
    latency_ms, tmp_path
):
    shipped = tomllib.loads((REPOSITORY / "config" / "follow-ball.toml").read_text())
    table = shipped["rules"]["follow"]["follow"]
    keys = ", ".join(f'{key} = "{value}"' for key, value in table.items())
    for path in (sways, swaying_path(1), swaying_path(2)):
        moments = follow(tmp_path, 35, path, latency_ms=latency_ms, rule=keys, most=shipped["base"]["max_speed"])
        assert min(each.gap_m for each in moments) > 0.5


@pytest.mark.long
def test_a_ball_that_is_hidden_for_a_second_is_followed_again_within_1_5_s(base, tmp_path):
    moments = follow(tmp_path, 8, walks_away, base=base, hidden=lambda at_s: 4 <= at_s < 5)
    (span_s,) = out_of_sight_s(moments)
    assert span_s <= 1.5
    assert abs(moments[-1].gap_m - 1) < 0.1


@pytest.mark.long
def test_a_ball_that_leaves_the_view_is_found_within_8_s(base, tmp_path):
    moments = follow(tmp_path, 14, lambda at_s: (1.0, 0.0) if at_s < 2 else (-0.6, 0.8), base=base)
    (span_s,) = out_of_sight_s(moments)
    assert span_s <= 8.0
    assert any("search_begun" in each.events for each in moments)


@pytest.mark.long
def test_on_random_walks_it_runs_into_nothing_and_finds_its_ball_again(base, tmp_path):
    for seed in (101, 102):
        moments = follow(tmp_path, 60, random_walk(seed, 60), base=base)
        assert min(each.gap_m for each in moments) > 0.5
        assert is_within_limits(moments)
        assert all(span_s <= 8.0 for span_s in out_of_sight_s(moments))


# The simulated robot is the one that its base describes.

LINEAR_MPS, ANGULAR_RADPS = 0.3, 0.5


def driven(folder: Path, driver: str, world: str = "") -> tuple[float, float]:
    """Command a base for 2 s, and return how fast its robot then moves, in m/s and rad/s."""
    path = folder / "robot.toml"
    path.write_text(
        f"""{SIMULATED_BALL}
[base]
driver = "{driver}"
port = "emulated-{driver}"
wheel_diameter = "6.5 cm"
ticks_per_turn = 1440
track_width = "16 cm"

[rules.follow]
actuator = "base"
follow = {{ distance = "1 m", max_speed = "0.4 m/s" }}

[world]
{world}
"""
    )
    parts = build(load_configuration(path), speed=None)
    clock, robot = parts.clock, parts.shared.parts["world"].robot
    (output,) = (each for each in parts.outputs if each.name == "base")
    output.open()
    for _ in range(40):
        command = {"linear_mps": LINEAR_MPS, "angular_radps": ANGULAR_RADPS, "captured_at_s": clock.now_s()}
        output.apply(TwistCommand(output="base", **command))
        clock.sleep_until_s(clock.now_s() + 0.05)
        output.check(clock.now_s())
    left_mps, right_mps = robot.wheels_mps
    output.close()
    for close in reversed(parts.shared.closers):
        close()
    return (left_mps + right_mps) / 2, (right_mps - left_mps) / robot.track_width_m


@pytest.mark.parametrize("driver", ["roboclaw", "ros-arduino-bridge"])
def test_an_emulated_robot_moves_as_commanded_whatever_wheels_its_base_says_it_has(tmp_path: Path, driver: str) -> None:
    # A command is rounded to whole ticks.
    assert driven(tmp_path, driver) == pytest.approx((LINEAR_MPS, ANGULAR_RADPS), rel=0.05)


def test_a_robot_that_differs_from_what_its_base_says_is_written_in_its_world(tmp_path: Path) -> None:
    half = f"ticks_per_metre = {1440 / (3.14159 * 0.065) / 2}"
    linear_mps, _ = driven(tmp_path, "roboclaw", half)
    assert linear_mps == pytest.approx(2 * LINEAR_MPS, rel=0.02)


# Cars whose motors hang on pins, or on the channels of a chip: they follow, and the *wheels* stop.

PRACTICE = f"""\
[camera]
driver = "simulated"
{LENS}
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[base]
driver = "gpio-motors"
port = "emulated-gpio-motors"
left = {{ forward = 17, backward = 27, pwm = 12 }}
right = {{ forward = 16, backward = 20, pwm = 13 }}
track_width = "20 cm"
max_wheel_speed = "0.6 m/s"
minimum_duty = 0.25
max_speed = "0.4 m/s"

[rules.follow]
actuator = "base"
follow = {{ distance = "1 m", max_speed = "0.3 m/s" }}

[world]
ball_diameter = "20 cm"
track_width = "20 cm"
path = [{{ at = "0 s", x = "2.2 m", y = "0.5 m" }}]
loop = false
"""
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
