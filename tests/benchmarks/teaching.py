"""How well an alarm is taught by pointing: scenes with a hidden true rule. Run it for a table.

A scene is a place where people come by. Each visit has a nearest distance (0.5 to 3 m) and a time there (0.3 to 8 s);
every third steps back for a while and returns. The distance is measured five times a second, with noise that grows with
its square and lasts (correlation 0.6 from frame to frame). The hidden rule has a threshold, an on-delay, an off-delay
and a deadband; the configured one differs in one to four of them. A visit of which even the hidden rule is not sure (it
would act otherwise with a threshold or a delay that is 10 % off) is drawn anew.

Of three recordings, every alarm of the hidden rule is marked `fire`, from a second before to a second after, and every
alarm of the configured rule that is none of these `no`. The proposal is then held against two other recordings of the
same place: it must raise as many alarms as the hidden rule, each within 5 s of it. Every twentieth scene has a visit
twice, with opposite marks: it must be refused, with that pair named.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

import numpy as np

from stadimeter.app.recordings.journal import JournalHeader
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.errors import ConfigError
from stadimeter.workbench.replay.comparison import SAME_WITHIN_S
from stadimeter.workbench.replay.what_if import KeptRecording
from stadimeter.workbench.teaching.lesson import Lesson
from stadimeter.workbench.teaching.marks import Firing, FiringMark
from stadimeter.workbench.teaching.signal import Signal
from support.observing import measured

FRAME_S = 0.2
VISITS = 20
FAR_M = 4.0
MARGIN = 0.1
KNOWN_S = 1.0
TEACHING, HELD_OUT = ("monday.jsonl", "tuesday.jsonl", "wednesday.jsonl"), ("thursday.jsonl", "friday.jsonl")
DAYS = (*TEACHING, *HELD_OUT)
FOLDER = Path(mkdtemp())
RULE = "near"

CONFIGURATION = """
[camera]
driver = "simulated"
model = "camera.toml"
[targets.ball]
detector = "ideal"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
[rules.near]
when = {{ below = "{below:.4f} m", deadband = "{deadband:.4f} m" }}
on_delay = "{on_delay:.3f} s"
off_delay = "{off_delay:.3f} s"
"""


class Settings(NamedTuple):
    """Those of a rule."""

    below: float
    on_delay: float
    off_delay: float
    deadband: float


class Cycle(NamedTuple):
    """A cycle that was not written to a file."""

    seen: Observation
    reloaded: None = None

    def observation(self) -> Observation:
        return self.seen

    def now_s(self) -> float:
        return self.seen.now_s


class InMemory(NamedTuple):
    """A recording that was not written to a file."""

    path: Path
    header: JournalHeader
    seen: Sequence[Cycle]

    def cycles(self) -> Iterator[Cycle]:
        return iter(self.seen)

    def is_cut_off(self) -> bool:
        return False


class Result(NamedTuple):
    """What came of a scene."""

    outcome: str
    took_s: float
    settings: str


def load(settings: Settings) -> Configuration:
    path = FOLDER / "stadimeter.toml"
    (FOLDER / "camera.toml").write_text(camera_file_text(CameraModel.with_focal_length(600.0, 640, 480)))
    return load_configuration(path, texts={path: text_of(settings)})


def text_of(settings: Settings) -> str:
    return CONFIGURATION.format(**settings._asdict())


def draw_rules(random_: random.Random) -> tuple[Settings, Settings]:
    """Return the hidden rule and the configured one."""
    hidden = Settings(
        random_.uniform(0.8, 2.0), random_.choice([0.0, 0.5, 1.0, 2.0, 3.0]),
        random_.choice([0.5, 1.0, 2.0, 4.0]), random_.choice([0.0, 0.1, 0.2, 0.3]),
    )  # fmt: skip
    other = {
        "below": hidden.below * math.exp(random_.choice([-1, 1]) * random_.uniform(0.15, 0.5)),
        "on_delay": random_.choice([each for each in (0.0, 0.5, 1.0, 2.0, 3.0) if each != hidden.on_delay]),
        "off_delay": random_.choice([each for each in (0.5, 1.0, 2.0, 4.0) if each != hidden.off_delay]),
        "deadband": random_.choice([each for each in (0.0, 0.1, 0.2, 0.3) if each != hidden.deadband]),
    }
    keys = random_.sample(sorted(other), random_.randint(1, 4))
    return hidden, hidden._replace(**{key: other[key] for key in keys})


def draw_visit(random_: random.Random) -> list[float]:
    """Return the true distances of one visit, a frame each."""
    nearest_m = math.exp(random_.uniform(math.log(0.5), math.log(3.0)))
    stays = [random_.uniform(0.3, 8.0)]
    back_m, away_s = random_.uniform(0.05, 0.8), random_.uniform(0.3, 6.0)
    if random_.random() < 1 / 3:
        stays.append(random_.uniform(0.3, 8.0))
    path = [FAR_M] * round(random_.uniform(3, 8) / FRAME_S)
    speed_mps = random_.uniform(0.5, 1.5)
    for number, stay_s in enumerate(stays):
        if number:
            path += way(path[-1], min(FAR_M, nearest_m + back_m), speed_mps) + [nearest_m + back_m] * round(
                away_s / FRAME_S
            )
        path += way(path[-1], nearest_m, speed_mps) + [nearest_m] * round(stay_s / FRAME_S)
    return path + way(path[-1], FAR_M, speed_mps) + [FAR_M] * round(5 / FRAME_S)


def way(from_m: float, to_m: float, speed_mps: float) -> list[float]:
    return np.linspace(from_m, to_m, max(2, round(abs(to_m - from_m) / speed_mps / FRAME_S))).tolist()


def is_sure(visit: Sequence[float], hidden: Settings) -> bool:
    """Return whether the hidden rule does the same if its threshold and its delays are a little off."""
    at_s = np.arange(len(visit)) * FRAME_S
    value = np.array(visit)
    noise = np.full(len(visit), 1e-6)
    signal = Signal(at_s=at_s, judged_s=at_s, value=value, sigma=noise, noise=noise, begins=np.zeros(0))
    counts = set()
    for key in Settings._fields:
        for factor in (1 - MARGIN, 1.0, 1 + MARGIN):
            more = 0.0 if key in {"below", "deadband"} else (factor - 1) * 2
            rule = load_rule(hidden._replace(**{key: max(0.0, getattr(hidden, key) * factor + more)}))
            counts.add(len(signal.firings(rule, rule.condition)))
    return len(counts) == 1


def load_rule(settings: Settings) -> AlarmRule:
    condition = DistanceCondition(below_m=settings.below, deadband_m=settings.deadband)
    delay = OnDelay(hold_s=settings.on_delay)
    return AlarmRule(name=RULE, target="ball", condition=condition, on_delay=delay, off_delay_s=settings.off_delay)


def record(name: str, visits: Sequence[Sequence[float]], random_: random.Random) -> InMemory:
    """Return the recording of some visits."""
    error = random_.gauss(0, 1)
    cycles = []
    for number, true_m in enumerate(each for visit in visits for each in visit):
        error = 0.6 * error + 0.8 * random_.gauss(0, 1)
        sigma_m = 0.006 * true_m**2
        at_s = number * FRAME_S
        seen = measured("ball", at_s, true_m + error * sigma_m, sigma_m)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        cycles.append(Cycle(Observation(now_s=at_s + 0.01, frame=frame, measurements=(seen,))))
    header = JournalHeader(stadimeter_journal=1, version="", began_at="", configuration="", configuration_sha256="")
    return InMemory(FOLDER / name, header, cycles)


def keep(recording: InMemory, configuration: Configuration) -> KeptRecording:
    kept = KeptRecording(recording=recording, configuration=configuration)
    kept.go_on(math.inf)
    return kept


def firings_of(kept: KeptRecording, configuration: Configuration) -> list[Firing]:
    return kept.decide_with(configuration.plan).rules[RULE].spans


def marks_of(name: str, hidden: Sequence[Firing], configured: Sequence[Firing]) -> Iterator[FiringMark]:
    for begin, _ in hidden:
        yield FiringMark(recording=name, from_s=begin - KNOWN_S, to_s=begin + KNOWN_S, should_fire=True)
    for begin, end in configured:
        if any(abs(first - begin) <= KNOWN_S for first, _ in hidden):
            continue
        until_s = min([end, *(first - KNOWN_S - FRAME_S for first, _ in hidden if first > begin)])
        if until_s > begin:
            yield FiringMark(recording=name, from_s=begin, to_s=until_s, should_fire=False)


def same(first: Sequence[Firing], second: Sequence[Firing]) -> bool:
    return len(first) == len(second) and all(
        abs(one[0] - other[0]) <= SAME_WITHIN_S for one, other in zip(first, second, strict=True)
    )


def try_scene(seed: int) -> Result:
    """Return what came of one scene."""
    random_ = random.Random(seed)  # noqa: S311 - scenes that can be drawn again
    hidden, configured = draw_rules(random_)
    truth, configuration = load(hidden), load(configured)
    kept = {name: keep(record(name, draw_visits(random_, hidden), random_), configuration) for name in DAYS}
    lesson = Lesson(configuration=configuration, text=text_of(configured))
    lesson.recordings.update({name: kept[name] for name in TEACHING})
    marks = [
        mark
        for name in TEACHING
        for mark in marks_of(name, firings_of(kept[name], truth), kept[name].side.rules[RULE].spans)
    ]
    is_contradictory = seed % 20 == 0
    if is_contradictory:
        marks = contradict(lesson, truth, marks)
    began_s = time.process_time()
    try:
        values = lesson.propose(RULE, marks).values
    except ConfigError as error:
        outcome = "refused, the pair named" if is_contradictory and "contradict" in str(error) else "refused"
        return Result(outcome, time.process_time() - began_s, f"{hidden} {configured} {error}")
    took_s, new = time.process_time() - began_s, lesson.load(RULE, values)
    is_equal = all(same(firings_of(kept[name], truth), firings_of(kept[name], new)) for name in HELD_OUT)
    outcome = "a contradiction not found" if is_contradictory else "equal" if is_equal else "other alarms"
    return Result(outcome, took_s, f"{hidden} {configured} {dict(values)}")


def draw_visits(random_: random.Random, hidden: Settings) -> list[list[float]]:
    """Return visits of which the hidden rule is sure."""
    visits = iter(lambda: draw_visit(random_), None)
    return list(islice((visit for visit in visits if is_sure(visit, hidden)), VISITS))


def contradict(lesson: Lesson, hidden: Configuration, marks: Sequence[FiringMark]) -> list[FiringMark]:
    """Return marks of which two contradict: the first recording once more, with one alarm of it marked `no`."""
    twin = lesson.recordings["twin.jsonl"] = lesson.recordings[TEACHING[0]]
    firings = firings_of(twin, hidden)
    no = [
        FiringMark(recording="twin.jsonl", from_s=begin - 1, to_s=begin + 1, should_fire=False)
        for begin, _ in firings[:1]
    ]
    return [*marks, *no]


def measure_all(seeds: Iterable[int]) -> list[Result]:
    """Try scenes, and tell of each on stderr; return what came of each."""
    found = []
    for seed in seeds:
        found.append(result := try_scene(seed))
        settings = result.settings if result.outcome != "equal" else ""
        print(seed, f"{result.took_s:.1f} s", result.outcome, settings, file=sys.stderr, flush=True)
    return found


def markdown(results: Sequence[Result]) -> str:
    """Return the table."""
    counts = Counter(result.outcome for result in results)
    took = sorted(result.took_s for result in results)
    rows = [f"| {outcome} | {count} |" for outcome, count in counts.most_common()]
    time_row = f"| time to propose: median, longest | {took[len(took) // 2]:.1f} s, {took[-1]:.1f} s |"
    return "\n".join(["| scenes | |", "| --- | ---: |", *rows, time_row])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    given = parser.parse_args()
    print(markdown(measure_all(range(given.first, given.first + given.count))))
