"""Trying what shall happen before everything is answered: on what the camera saw, and on a target that is made up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from stadimeter.config.loader import Configuration
from stadimeter.config.rule_test_tables import InputTable
from stadimeter.config.units import DURATIONS_S, parse_quantity
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.errors import ConfigError
from stadimeter.workbench.rule_tests.running import WAIT_S, observations
from stadimeter.workbench.rule_tests.synthetic_track import sensor_models
from stadimeter.workbench.setup.known import Known
from stadimeter.workbench.setup.wish_steps import SCREEN, seen_up_to_m, wanted
from stadimeter.workbench.setup.wishes import figure_si, ready_answers

LAST_S = 60.0
"""What the camera saw is looked at so far back."""

ENOUGH_S = 2.0
"""Less than this of it says nothing."""

WALK_S, STAND_S, GONE_S = 6.0, 2.0, 3.0
"""How long the target that is made up takes to come and to go, stands at both ends, and is out of sight at last."""

LONGEST_S = 700.0

GAP_S = 1.0
"""Where nothing was seen for longer, time went on without frames."""


def complete_answers(known: Known, changed: Mapping[str, str]) -> dict[str, str]:
    """Return answers that make a configuration: those given, those that are being changed, else the ready ones.

    Outputs that are not chosen yet are shown on the screen only.

    Raises:
        ConfigError: There is no wish yet, or no lens.
    """
    if known.camera_model is None or "wish" not in known.answers:
        raise ConfigError("first choose what shall happen")
    answers = {**known.answers, **changed}
    for wish in wanted(answers):
        for key, ready in ready_answers(wish, seen_up_to_m(known)).items():
            answers.setdefault(f"{wish.key}_{key}", ready)
        match wish.output:
            case "base":
                answers.setdefault("base", SCREEN)
            case "mqtt":
                answers.setdefault("broker", "127.0.0.1")
            case _:
                answers.setdefault(f"{wish.key}_output", SCREEN)
        if wish.key == "apart" and "apart_second" not in answers:
            raise ConfigError("first say how the second target differs from the first")
    return answers


def seen_lately(history: Sequence[Measurement]) -> Iterator[Observation]:
    """Yield what the camera has seen in the last minute, as a run would have had it; nothing if that is too little."""
    since_s = history[-1].captured_at_s - LAST_S if history else 0.0
    lately = [each for each in history if each.captured_at_s >= since_s]
    if not lately or lately[-1].captured_at_s - lately[0].captured_at_s < ENOUGH_S:
        return
    before_s = lately[0].captured_at_s
    for number, measured in enumerate(lately):
        now_s = measured.captured_at_s
        if now_s - before_s > GAP_S:
            waits = range(1, int((now_s - before_s) / WAIT_S))
            yield from (Observation(now_s=before_s + count * WAIT_S, camera_fault="no frame") for count in waits)
        stamp = FrameStamp(sequence=number, captured_at_s=now_s)
        yield Observation(now_s=now_s, frame=stamp, measurements=(measured,))
        before_s = now_s


def made_up(configuration: Configuration, answers: Mapping[str, str]) -> Iterator[Observation]:
    """Yield what would be seen of a target that comes from beyond every distance of the wishes, goes back, and is gone.

    A second target stands still half way.
    """
    lengths_m, times_s = _figures(answers)
    far_m, near_m = 1.5 * max(lengths_m, default=2.0), 0.6 * min(lengths_m, default=1.0)
    gone_s = min(LONGEST_S, max(GONE_S, *(1.2 * each for each in times_s), 0.0))
    points, at_s = [], 0.0
    for distance_m, stays_s in ((far_m, STAND_S), (near_m, max(STAND_S, WALK_S / 2)), (far_m, STAND_S + gone_s)):
        points += [(at_s, distance_m), (at_s + stays_s, distance_m)]
        at_s += stays_s + WALK_S
    end_s = points[-1][0]
    first, *others = configuration.plan.targets
    walk = {
        "points": [{"at": f"{moment_s} s", "distance": f"{distance_m} m"} for moment_s, distance_m in points],
        "lost": [{"from": f"{end_s - gone_s} s", "for": f"{gone_s + 1} s"}],
    }
    still = {"hover": {"at": f"{(far_m + near_m) / 2} m", "for": f"{end_s} s"}}
    table = {"targets": {first: walk, **dict.fromkeys(others, still)}, "rate": "10 Hz"}
    yield from observations(InputTable.model_validate(table), configuration, sensor_models(configuration))


def _figures(answers: Mapping[str, str]) -> tuple[list[float], list[float]]:
    """Return the distances of the wishes in metres, and their times in seconds."""
    lengths_m, times_s = [], []
    for wish in wanted(answers):
        for blank in wish.blanks:
            text = answers[f"{wish.key}_{blank.key}"]
            try:
                if blank.is_length:
                    lengths_m.append(figure_si(text, blank))
                else:
                    times_s.append(parse_quantity(text, DURATIONS_S, blank.ready))
            except ValueError:
                continue  # a speed, or what the question refuses
    return lengths_m, times_s
