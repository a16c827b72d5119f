"""The proof: every sequence of up to a few faults, at every moment of a grid, each a trial of its own.

Sequences that differ only in the order of faults at one moment are one. The first fault comes while the robot drives at
full speed; when that is on the run's clock makes no difference but for the phase of its timers, so only later faults
are moved, to every one of `MOMENTS_S` after the first.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import random
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations_with_replacement, pairwise, product
from pathlib import Path

from msgspec import Struct, field

from scenario.prove.faults import BY_NAME, FINAL, LASTS_S, STOPS_PROCESS, FaultSequence, PlannedFault
from scenario.prove.staging import StagedConfiguration, stage
from scenario.prove.trial import TrialResult, run_trial
from stadimeter.config.loader import load_configuration
from stadimeter.errors import StadimeterError

# The robot drives at full speed by then: it starts on the third frame, and half a second of acceleration is usual.
FIRST_AT_S = 1.5

# Later faults begin with the first; before the stop that follows from it is due; when the wheels have just stopped;
# when faults that last for a second have just ended, and frames are not yet enough in a row; and while a base rests
# whose cable was out, or as soon as the robot drives again.
MOMENTS_S = (0.0, 0.1, 0.4, 1.05, 2.5)

# Sequences that a process takes at a time. With fewer of them than a few times this, one process is faster.
_CHUNK = 16


class Proof(Struct, kw_only=True):
    """What came of it.

    Attributes:
        faults_max: The largest number of faults in a sequence.
        parts: What was watched: ``wheels`` or ``servos``.
        trials: How many sequences were tried.
        planned: How many there are.
        simulated_s: How long the robot was driven in all, in its own time.
        longest: By reason, for how long the wheels turned at most, and with which faults.
        counter_example: The first sequence that broke a limit; None if none did.
    """

    faults_max: int
    alphabet: tuple[str, ...]
    parts: str
    trials: int = 0
    planned: int = 0
    simulated_s: float = 0.0
    longest: dict[str, tuple[float, FaultSequence]] = field(default_factory=dict)
    counter_example: TrialResult | None = None

    def add(self, result: TrialResult) -> None:
        """Add one trial."""
        self.trials += 1
        self.simulated_s += result.simulated_s
        for reason, seconds in result.longest_s.items():
            if seconds > self.longest.get(reason, (0.0,))[0]:
                self.longest[reason] = (seconds, result.sequence)
        if result.violation is not None:
            self.counter_example = result


def sequences(alphabet: Sequence[str], faults_max: int) -> Iterator[FaultSequence]:
    """Yield every sequence, those of fewer faults first; the first has none at all."""
    yield ()
    for count in range(1, faults_max + 1):
        for moments_s in combinations_with_replacement(MOMENTS_S, count - 1):
            at_s = [FIRST_AT_S + moment_s for moment_s in (0.0, *moments_s)]
            for chosen in product(alphabet, repeat=count):
                planned = tuple(map(PlannedFault, at_s, chosen))
                if all(one < next_one for one, next_one in pairwise(planned)) and _can_matter(planned):
                    yield planned


def _can_matter(planned: FaultSequence) -> bool:
    """Return whether no fault but the last is one after which nothing moves the base, except at the same moment."""
    return all(each.fault not in FINAL or each.at_s == planned[-1].at_s for each in planned[:-1])


def _is_held(planned: FaultSequence) -> bool:
    """Return whether the watchdog process lives whenever the program is stopped or dead."""
    gone_s = [each.at_s for each in planned if each.fault == "kill-watchdog"]
    stopped = [each for each in planned if each.fault in STOPS_PROCESS]
    return not any(each.at_s <= at_s < each.at_s + LASTS_S[each.fault] for each in stopped for at_s in gone_s)


def prove(
    path: Path,
    faults_max: int,
    journal: Path,
    only: Sequence[str] = (),
    tell: Callable[[int, int], None] = lambda _done, _total: None,
    within_s: float = math.inf,
) -> Proof:
    """Try every sequence, until one breaks a limit. The same configuration always gives the same result.

    Args:
        path: The configuration.
        journal: Where to write what the core saw and decided in a counter-example.
        only: The names of the faults to try; empty for all that this configuration can suffer.
        tell: Takes how many sequences are done, of how many.
        within_s: After this long it ends with those that are done: a random sample among the longest sequences.

    Raises:
        ConfigError: The configuration is wrong, or there is nothing to prove.
        StadimeterError: A fault has another name, or the robot does not drive even without faults, so that any stop
            would be proven.
    """
    staged = _load(path)
    able = staged.alphabet()
    if unknown := set(only).difference(able):
        raise StadimeterError(f"this configuration cannot suffer {', '.join(unknown)}; it can: {', '.join(able)}")
    alphabet = tuple(each for each in able if each in (only or set(able) - BY_NAME))
    proof = Proof(faults_max=faults_max, alphabet=alphabet, parts=staged.limits.parts)
    until_s = time.monotonic() + within_s
    planned = [
        each for each in sequences(proof.alphabet, faults_max) if staged.limits.beyond_s < math.inf or _is_held(each)
    ]
    random.Random(1).shuffle(planned)  # noqa: S311 - so that a sample of the longest is spread
    planned.sort(key=len)
    proof.planned = len(planned)
    for result in _results(path, staged, planned):
        proof.add(result)
        _check_it_drives(result, staged)
        tell(proof.trials, proof.planned)
        if result.violation is not None:
            run_trial(staged, result.sequence, journal)
        if result.violation is not None or time.monotonic() > until_s:
            break
    return proof


def _load(path: Path) -> StagedConfiguration:
    return stage(load_configuration(path, with_tests=False))


def _check_it_drives(result: TrialResult, staged: StagedConfiguration) -> None:
    limits = staged.limits
    if result.violation is None and result.driven < limits.cruise / 2:
        raise StadimeterError(
            f"nothing can be proven: the {limits.parts} turn at {result.driven:.2f} {limits.unit} at most before any "
            f"fault, though the target leads the robot on and its rule may follow at {limits.cruise:.2f} "
            f"{limits.unit}; look at what the other rules ask of the base"
        )


def _results(path: Path, staged: StagedConfiguration, planned: Sequence[FaultSequence]) -> Iterator[TrialResult]:
    """Yield the result of each sequence, in order."""
    if len(planned) <= 4 * _CHUNK:
        yield from (run_trial(staged, sequence) for sequence in planned)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    pool = ProcessPoolExecutor(os.cpu_count(), mp_context=context, initializer=_begin_worker, initargs=(path,))
    try:
        yield from pool.map(_run_one, planned, chunksize=_CHUNK)
    finally:
        pool.shutdown(cancel_futures=True)


_STAGED: list[StagedConfiguration] = []


def _begin_worker(path: Path) -> None:
    _STAGED.append(_load(path))


def _run_one(sequence: FaultSequence) -> TrialResult:
    return run_trial(_STAGED[0], sequence)
