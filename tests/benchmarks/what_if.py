"""How soon a dragged threshold is answered: ten minutes at 30 a second, judged again. Run it for a table.

The recording is one of `teaching`, with visits. Wall time and processor time are printed: they are the same on a
machine that does nothing else. The answer is compared with that of a replay. Memory is what the process grew by.
"""

from __future__ import annotations

import argparse
import math
import random
import resource
import time
from collections.abc import Callable
from typing import NamedTuple

import teaching

from stadimeter.workbench.replay.comparison import compare
from stadimeter.workbench.replay.lanes import SideBySide
from stadimeter.workbench.replay.replay import ReplayRun
from stadimeter.workbench.replay.what_if import KeptRecording
from stadimeter.workbench.teaching.lesson import Lesson

CYCLES = 18_000


class Row(NamedTuple):
    """What one thing took."""

    what: str
    wall_s: float
    processor_s: float
    megabytes: float = 0.0


def measure_all(cycles: int = CYCLES) -> tuple[list[Row], bool]:
    """Return what reading, a dragged threshold and a replay take, and whether the last two say the same."""
    random_ = random.Random(1)  # noqa: S311 - a recording that can be made again
    rule = teaching.Settings(1.0, 0.5, 1.0, 0.1)
    configuration = teaching.load(rule)
    visits = [teaching.draw_visit(random_) for _ in range(cycles // 60 + 1)]
    recording = teaching.record("ten-minutes.jsonl", visits, random_)
    recording = recording._replace(seen=recording.seen[:cycles])
    kept = KeptRecording(recording=recording, configuration=configuration)
    lesson = Lesson(configuration=configuration, text=teaching.text_of(rule), recordings={"ten-minutes.jsonl": kept})
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows = [_timed("reading, once", lambda: kept.go_on(math.inf))]
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib) / 1024
    rows[0] = rows[0]._replace(megabytes=grown_mb)
    answers = []
    rows += [
        _timed(f"threshold at {below_m} m", lambda at=below_m: answers.append(_ask(lesson, at)))  # type: ignore[misc]
        for below_m in (0.8, 1.0, 1.2, 1.5, 2.0)
    ]
    new = lesson.load(teaching.RULE, {"below": 2.0})
    beside = SideBySide(ReplayRun(recording, configuration), ReplayRun(recording, new))
    rows.append(_timed("replay --diff", lambda: beside.go_on(math.inf)))
    found = compare(kept.side.tally, answers[-1].after.tally)
    return rows, (found.rules, found.same) == (beside.difference().rules, beside.difference().same)


def _ask(lesson: Lesson, below_m: float) -> object:
    """Answer as the page is answered: the text is changed, loaded, and judged."""
    return lesson.answer(lesson.load(teaching.RULE, {"below": below_m}).plan)[0]


def _timed(what: str, act: Callable[[], object]) -> Row:
    began_s, processor_s = time.perf_counter(), time.process_time()
    act()
    return Row(what, time.perf_counter() - began_s, time.process_time() - processor_s)


def markdown(rows: list[Row], is_same: bool) -> str:
    """Return the table."""
    lines = ["| ten minutes, 18,000 cycles | wall | processor | memory |", "| --- | ---: | ---: | ---: |"]
    for what, wall_s, processor_s, megabytes in rows:
        lines.append(
            f"| {what} | {wall_s:.2f} s | {processor_s:.2f} s | {f'{megabytes:.0f} MB' if megabytes else ''} |"
        )
    return "\n".join([*lines, "", f"The answers are {'' if is_same else 'NOT '}those of `replay --diff`."])


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(markdown(*measure_all()))
