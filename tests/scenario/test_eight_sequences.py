"""The eight sequences on which a well-known trigger fails, each with the outcome that is promised here.

That trigger fires three times on noise, never when the target was inside already, again after a gap in which nothing
was crossed, never when a target skips a narrow band, and on a distance that is no number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from msgspec import Struct

from stadimeter.config.loader import load_configuration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import FrameStamp, Observation
from support.observing import measured, missed
from support.simulated_run import SIMULATED_BALL

FRAME_S = 1 / 30
SIGMA_M = 0.015
GONE = None

BELOW_ONE_METRE = """
[rules.near]
actuator = "motor"
when = { below = "1 m" }
"""


class Outcome(Struct, frozen=True):
    """What a sequence came to: events of the rule with the number of the frame, and the level of its output."""

    events: list[tuple[str, int]]
    levels: list[float]
    decisions: list[Decision]

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.events]


Run = Callable[..., Outcome]


def seen(at_s: float, distance_m: float | None) -> Measurement:
    return missed("ball", at_s) if distance_m is None else measured("ball", at_s, distance_m, SIGMA_M)


def for_s(seconds: float, distance_m: float | None) -> list[float | None]:
    return [distance_m] * round(seconds / FRAME_S)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Return a function that shows a rule distances, a frame each."""

    def of(distances_m: Iterable[float | None], rules: str = BELOW_ONE_METRE) -> Outcome:
        file = tmp_path / "sequence.toml"
        file.write_text(SIMULATED_BALL + "[world]\n" + rules, encoding="utf-8")
        plan = load_configuration(file).plan
        state, outcome = initial_state(plan), Outcome([], [], [])
        for frame, distance_m in enumerate(distances_m):
            at_s = frame * FRAME_S
            observation = Observation(
                now_s=at_s, frame=FrameStamp(sequence=frame, captured_at_s=at_s), measurements=(seen(at_s, distance_m),)
            )
            state, decision = decide(state, observation)
            outcome.events.extend((event.kind.value, frame) for event in decision.events if event.source == "near")
            outcome.levels.append(decision.commands[0].level)
            outcome.decisions.append(decision)
        return outcome

    return of


def test_1_a_target_that_comes_in_raises_the_rule_once(run: Run) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(3, 0.8)])
    assert outcome.kinds == ["raised"]
    ((_, frame),) = outcome.events
    assert frame * FRAME_S - 1 <= 0.5, "a jump of metres is believed when it lasts, not at its first frame"
    assert outcome.levels[-1] == 1.0


def test_1_a_target_that_truly_comes_in_is_noticed_within_a_tenth_of_a_second(run: Run) -> None:
    coming = [3.0 - 2.0 * frame * FRAME_S for frame in range(round(1.1 / FRAME_S))]
    outcome = run([*for_s(1, 3.0), *coming, *for_s(1, coming[-1])])
    ((kind, frame),) = outcome.events
    assert kind == "raised"
    assert 0 <= frame * FRAME_S - 2.0 <= 0.1 + FRAME_S


def wavering(each_s: float) -> list[float | None]:
    return [distance_m for value_m in (0.98, 1.02, 0.97, 1.03, 0.99) for distance_m in for_s(each_s, value_m)]


@pytest.mark.parametrize("each_s", [FRAME_S, 0.5])
def test_2_noise_around_the_limit_raises_it_once_at_most(run: Run, each_s: float) -> None:
    outcome = run([*for_s(1, 3.0), *(wavering(each_s) * 3)])
    assert len(outcome.kinds) <= 1
    assert "cleared" not in outcome.kinds


def test_2_a_target_that_truly_goes_to_and_fro_is_kept_by_a_deadband_as_wide(run: Run) -> None:
    """Three centimetres for two seconds are no noise to a camera that is sure to one."""
    wide = BELOW_ONE_METRE.replace('"1 m" }', '"1 m", deadband = "5 cm" }')
    assert run([*for_s(1, 3.0), *(wavering(2.0) * 3)], wide).kinds == ["raised"]


def test_3_a_target_that_is_inside_at_the_start_raises_it(run: Run) -> None:
    outcome = run([*for_s(1, 0.8), *for_s(1, 0.7), *for_s(1, 0.5)])
    assert outcome.kinds == ["raised"]
    ((_, frame),) = outcome.events
    assert frame * FRAME_S <= 0.2
    (event,) = (event for each in outcome.decisions for event in each.events if event.source == "near")
    assert event.reason.startswith("so from the start")


@pytest.mark.parametrize("gap_s", [FRAME_S, 4.0])
def test_4_a_gap_in_which_nothing_was_crossed_raises_nothing_again(run: Run, gap_s: float) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(2, 0.8), *for_s(gap_s, GONE), *for_s(2, 0.8)])
    assert outcome.kinds == ["raised"]
    assert outcome.levels[-1] == 1.0


def test_4_a_long_gap_is_told_and_its_end_too_but_it_is_not_raised_again(run: Run) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(2, 0.8), *for_s(8, GONE), *for_s(2, 0.8)])
    assert outcome.kinds == ["raised", "measurement_lost", "measurement_back"]
    assert outcome.levels[-2 * 30 - 1] == 0.0, "nothing acts for long on what nobody sees"
    assert outcome.levels[-1] == 1.0


NARROW = """
[rules.near]
actuator = "motor"
when = { between = ["90 cm", "1 m"], deadband_sigmas = 1 }
on_delay = "0 s"
"""


def test_6_a_target_that_skips_a_narrow_band_between_two_frames_is_caught(run: Run) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(3, 0.4)], NARROW)
    assert outcome.kinds == ["raised", "cleared"]
    assert max(outcome.levels) == 1.0
    assert outcome.levels[-1] == 0.0


def test_6_so_is_one_that_truly_flies_through_it(run: Run) -> None:
    flying = [5.04 - 5.0 * frame * FRAME_S for frame in range(28)]
    assert not any(0.89 < distance_m < 1.01 for distance_m in flying)
    outcome = run([*flying, *for_s(3, flying[-1])], NARROW)
    tracks = [each.tracks[0].status.value for each in outcome.decisions[1:28]]
    assert set(tracks) == {"tracking"}
    assert outcome.kinds == ["raised", "cleared"]


def test_6_a_rule_that_asks_the_target_to_stay_is_not_raised_by_one_that_flies_through(run: Run) -> None:
    staying = NARROW.replace('on_delay = "0 s"', "on_delay = { frames = 3, of = 5 }")
    assert run([*for_s(1, 3.0), *for_s(3, 0.4)], staying).kinds == []


def test_6_being_found_on_the_other_side_is_no_passing_through(run: Run) -> None:
    assert run([*for_s(1, 3.0), *for_s(1, GONE), *for_s(3, 0.4)], NARROW).kinds == []


LONG = """
[rules.near]
actuator = "motor"
when = { below = "1 m" }
on_delay = "1 s"
"""


def test_7_one_frame_to_the_contrary_does_not_start_the_on_delay_again(run: Run) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(0.8, 0.8), 1.01, *for_s(2, 0.8)], LONG)
    undisturbed = run([*for_s(1, 3.0), *for_s(3, 0.8)], LONG)
    assert outcome.kinds == undisturbed.kinds == ["raised"]
    ((_, frame),), ((_, other),) = outcome.events, undisturbed.events
    assert frame - other <= 2


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf, -1.0, 0.0])
def test_8_a_distance_that_is_no_distance_is_unknown_and_raises_nothing(run: Run, broken: float) -> None:
    outcome = run([*for_s(1, 3.0), *for_s(2, broken)])
    assert outcome.kinds == []
    assert set(outcome.levels) == {0.0}
    assert outcome.decisions[-1].rules[0].status.value == "unknown"
