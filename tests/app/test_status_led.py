"""The status LED: what it shows of a run, and that it goes dark when nothing runs."""

from __future__ import annotations

from itertools import pairwise

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.guard import REST_S, Guard
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.panel import LEASE_S, Status, StatusLed, status_of
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, DriverContext, load_driver
from stadimeter.core.decision import Decision, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import Observation, OutputFault
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case
from support.pins import WatchedPins
from support.simulated_run import SIMULATED_BALL

PIN = 17
TICK_S = 0.02


def cycle(now_s: float = 0.0, /, **known: object) -> CycleRecord:
    """Return a cycle in which all is well, but for what is known besides."""
    seen = {key: known.pop(key) for key in ("camera_fault", "not_for_motion", "output_faults") if key in known}
    decided = {"safety": SafetyMode.ACTIVE, "safety_reason": "", "tracks": (), "rules": (), **known}
    decision = Decision(commands=(), events=(), outputs=(), **decided)  # type: ignore[arg-type]
    observation = Observation(now_s=now_s, **seen)  # type: ignore[arg-type]
    return CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision)


BALL = (Track(target="ball", status=TrackStatus.TRACKING),)
WAITS = RuleTrace(rule="near", status=RuleStatus.RETURNED, acknowledged=False)
SHELVED = RuleTrace(rule="near", status=RuleStatus.ACTIVE, acknowledged=False, inhibits=("shelved",))
GONE = {"safety": SafetyMode.STALE, "camera_fault": "unplugged", "safety_reason": "300 ms old: unplugged"}
BROKEN = (OutputFault(output="motor", reason="unplugged"),)


@each_case(
    ("known", "status"),
    [
        ({}, Status.WATCHING),
        ({"camera_fault": "no frame within 100 ms"}, Status.WATCHING),
        ({"tracks": BALL}, Status.TRACKING),
        ({"tracks": (Track(target="ball", status=TrackStatus.LOST),)}, Status.WATCHING),
        ({"tracks": BALL, "rules": (SHELVED,)}, Status.QUIET),
        ({"safety": SafetyMode.STARTING}, Status.STARTING),
        ({"safety": SafetyMode.STARTING, "not_for_motion": "its age is not known"}, Status.HELD),
        ({"safety": SafetyMode.STALE}, Status.HELD),
        ({"safety": SafetyMode.STALE, "rules": (WAITS,)}, Status.ALARM),
        ({"safety": SafetyMode.STOPPED, "tracks": BALL}, Status.HELD),
        ({"tracks": BALL, "rules": (SHELVED, WAITS)}, Status.ALARM),
        ({"rules": (RuleTrace(rule="near", status=RuleStatus.LATCHED),)}, Status.ALARM),
        ({"rules": (WAITS,), "output_faults": BROKEN}, Status.FAULT),
        ({**GONE, "output_faults": BROKEN}, Status.BLIND),
        ({**GONE, "safety": SafetyMode.STARTING}, Status.BLIND),
        ({**GONE, "safety": SafetyMode.STARTING, "safety_reason": "1 of 3 fresh frames in a row"}, Status.STARTING),
    ],
)
def test_of_several_things_it_shows_what_matters_most(known, status):
    assert status_of(cycle(**known)) is status


def test_every_two_states_differ_in_their_rhythm_alone():
    def kind(status: Status) -> tuple[str, int, bool]:
        """Return what an eye goes by: mostly dark or lit, how often it flashes between pauses, fast or slow."""
        period_s = sum(for_s for _, for_s in status.value.steps)
        share = sum(level * for_s for level, for_s in status.value.steps) / period_s
        lit = [level > 0.5 for level, _ in status.value.steps]
        changes = sum(one != other for one, other in pairwise([*lit, lit[0]]))
        return "dark" if share < 0.3 else "lit" if share > 0.6 else "even", changes // 2, period_s < 0.5

    assert len({kind(status) for status in Status}) == len(Status) == 8


class Light:
    """A status LED on a pin, under guard."""

    def __init__(self) -> None:
        self.clock = ManualClock(start_s=20.0)
        context = DriverContext(name="status_led", clock=self.clock)
        self.pins = WatchedPins(context)
        model = load_driver(ACTUATORS, "led")
        self.led = StatusLed(model(pin=PIN).build(context), "status_led", self.clock)
        self.led.open()
        Guard([self.led], self.clock).start()

    def lit(self, seconds: float, record: CycleRecord | None = None) -> list[bool]:
        """Let time pass, with ten cycles a second if there is a record, and return whether it was lit at each tick."""
        seen = []
        for tick in range(round(seconds / TICK_S)):
            if record is not None and tick % 5 == 0:
                self.led.show(cycle(self.clock.now_s(), tracks=record.decision.tracks, rules=record.decision.rules))
            self.clock.advance_s(TICK_S)
            seen.append(self.pins.state(PIN) == 1.0)
        return seen


@pytest.fixture
def light() -> Light:
    return Light()


def flashes(lit: list[bool]) -> int:
    return sum(now and not before for before, now in pairwise(lit))


def test_it_keeps_its_rhythm_between_cycles(light):
    light.lit(0.1, cycle())
    assert flashes(light.lit(20.0, cycle())) == 10
    light.lit(0.1, cycle(tracks=BALL))
    assert flashes(light.lit(24.0, cycle(tracks=BALL))) == 20


def test_a_state_that_begins_shows_at_once(light):
    light.lit(1.0, cycle())
    light.led.show(cycle(light.clock.now_s(), rules=(WAITS,)))
    assert light.pins.state(PIN) == 1.0


def test_it_goes_dark_when_the_loop_hangs(light):
    alarm = cycle(rules=(WAITS,))
    assert any(light.lit(1.0, alarm))
    light.lit(LEASE_S + 0.1)
    assert not any(light.lit(5.0))
    assert any(light.lit(1.0, alarm))


def test_it_shows_nothing_on_a_cycle_that_is_too_old(light):
    light.led.show(cycle(light.clock.now_s() - LEASE_S - 0.1, rules=(WAITS,)))
    assert not any(light.lit(1.0))


def test_it_is_off_after_a_stop_whatever_comes_later(light):
    light.lit(1.0, cycle(rules=(WAITS,)))
    light.led.retire()
    assert not any(light.lit(3.0, cycle(rules=(WAITS,))))
    light.led.close()
    assert not light.pins.is_held()


def test_one_that_failed_blinks_again_when_its_pin_answers(light):
    light.lit(1.0, cycle(rules=(WAITS,)))
    light.pins.fail(PIN, begins=True)
    light.lit(1.0, cycle(rules=(WAITS,)))
    assert "status_led: cannot switch GPIO17" in light.led.fault
    light.pins.fail(PIN, begins=False)
    light.lit(8.0 + REST_S, cycle(rules=(WAITS,)))
    assert light.led.fault == ""
    assert any(light.lit(1.0, cycle(rules=(WAITS,))))


RUN = (
    SIMULATED_BALL
    + """
[status_led]
driver = "simulated"

[world]
path = [{ at = "0 s", x = "1 m", y = "0 m" }, { at = "20 s", x = "1 m", y = "0 m" }]

[rules.near]
actuator = "motor"
when = { below = "2 m" }
ack = "required"
"""
)


def test_in_a_run_it_blinks_and_is_off_at_the_end(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(RUN)
    loop = Loop(build(load_configuration(path), speed=None))
    assert loop.parts.status_led is not None
    actuator = loop.parts.status_led._rhythm._actuator
    seen: list[float] = []
    loop.parts.clock.call_every(0.02, lambda now_s: seen.append(actuator.level) if 1.0 < now_s < 6.0 else None)  # type: ignore[attr-defined]
    loop.run(Limits(seconds=6.0))
    assert 38 <= sum(before != level for before, level in pairwise(seen)) <= 44, (
        "an alarm waits: eight changes a second"
    )
    assert actuator.level == 0.0  # type: ignore[attr-defined]
