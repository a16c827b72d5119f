"""What is believed of pictures whose sender writes no time stamps, on a stepped clock: after stalls, and on live links.

A robot stands while it has no picture that is believed and younger than `MAX_AGE_S`. Two things are counted: stalls
after which it drove on pictures that were older by more than that, and on links that are live, how often it stood in
an hour, beside a robot that knows the true age of each picture.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Iterator
from pathlib import Path

from stadimeter.cameras.capture_time import StreamTime

RATE_HZ = 30.0
WAY_S = 0.02
MAX_AGE_S = 0.2
"""The frame age of `config/follow-ball.toml`."""

LEARNT_S = 20.0
"""How long a stream runs well before anything is counted."""

DROVE_S = 0.1
"""Driving for so long on pictures that are too old counts; less moves a robot by 3 cm at most."""

DRAINS = (1.02, 1.05, 1.07, 1.1, 1.15, 1.2, 1.3, 1.5, 2.0, 5.0, 20.0)
KEPT = (0, 5, 30, 10**6)
"""How many pictures of a stall a sender keeps."""

KNOWN = {"MJPEG over HTTP": False, "through FFmpeg": None}
"""Whether the next picture has begun to arrive with one; the least favourable answer, or that it is not known."""

Arrivals = Iterator[tuple[float, float]]


def stalled(drain: float, seed: int, *, jitter: float = 0.2) -> Arrivals:
    """Yield capture and arrival of pictures, of which some wait in a stall and leave at a multiple of the pace."""
    rng = random.Random(seed)  # noqa: S311 - the same stall for each seed
    stall_s, kept, period_s = rng.uniform(0.3, 5.0), rng.choice(KEPT), 1 / RATE_HZ
    every = [number * period_s for number in range(round((LEARNT_S + 2 * stall_s + 30) * RATE_HZ))]
    came = [(at_s, at_s + WAY_S + jitter * period_s * rng.random()) for at_s in every]
    over_s = LEARNT_S + stall_s
    waiting = [pair for pair in came if LEARNT_S <= pair[1] < over_s]
    gone = {at_s for at_s, _ in (waiting[:-kept] if kept else waiting)}
    last_s = 0.0
    for captured_s, arrived_s in came:
        if captured_s in gone:
            continue
        earliest_s = last_s + 1e-4
        if arrived_s >= LEARNT_S:
            earliest_s = max(over_s, last_s + period_s / drain * rng.uniform(1 - jitter, 1 + jitter))
        last_s = max(arrived_s, earliest_s)
        yield captured_s, last_s


def drove_on_old_s(arrivals: Arrivals, has_begun: bool | None) -> float:
    """Return for how long pictures were taken for fresh that were older than they seemed by `MAX_AGE_S`."""
    stream_time, drove_s, last_s = StreamTime(WAY_S), 0.0, 0.0
    for captured_s, arrived_s in arrivals:
        found_s = stream_time.captured_at_s(arrived_s, has_begun=has_begun)
        if found_s is not None and found_s - captured_s > MAX_AGE_S:
            drove_s += min(arrived_s - last_s, MAX_AGE_S)
        last_s = arrived_s
    return drove_s


def live(
    seed: int,
    hours: float,
    way_s: Callable[[random.Random], float],
    loss: float = 0.0,
    period_s: Callable[[float], float] = lambda _at_s: 1 / RATE_HZ,
) -> Arrivals:
    """Yield capture and arrival of pictures of a live link, in the order in which they were captured."""
    rng = random.Random(seed)  # noqa: S311 - likewise
    captured_s = last_s = 0.0
    while captured_s < 3600 * hours:
        captured_s += period_s(captured_s)
        arrived_s = captured_s + WAY_S + way_s(rng)
        if rng.random() >= loss:
            last_s = max(arrived_s, last_s + 1e-3)
            yield captured_s, last_s


def stops(arrivals: Arrivals, has_begun: bool | None) -> tuple[int, int, float]:
    """Return stops of a robot that knows the ages, stops of ours, and the share of time in which ours stood."""
    stream_time = StreamTime(WAY_S)
    known_s = believed_s = 0.0
    by_age = ours = 0
    stood_s = last_s = 0.0
    for captured_s, arrived_s in arrivals:
        found_s = stream_time.captured_at_s(arrived_s, has_begun=has_begun)
        if captured_s > LEARNT_S:
            by_age += last_s - known_s <= MAX_AGE_S < arrived_s - known_s
            ours += last_s - believed_s <= MAX_AGE_S < arrived_s - believed_s
            stood_s += max(0.0, arrived_s - max(last_s, believed_s + MAX_AGE_S))
        known_s = captured_s
        believed_s = believed_s if found_s is None else found_s
        last_s = arrived_s
    return by_age, ours, stood_s / (last_s - LEARNT_S)


def _gauss(rng: random.Random) -> float:
    return abs(rng.gauss(0, 0.01))


def _tailed(rng: random.Random) -> float:
    return abs(rng.gauss(0, 0.003)) + (rng.expovariate(1 / 0.05) if rng.random() < 0.01 else 0.0)


def _darker(at_s: float) -> float:
    """Return a period that is 1/30 s, and 1/20 s in each second five minutes: the camera exposes for longer."""
    return 1 / RATE_HZ if int(at_s / 300) % 2 == 0 else 1 / 20


LIVE: dict[str, Callable[[int, float], Arrivals]] = {
    "Gaussian jitter, 10 ms": lambda seed, hours: live(seed, hours, _gauss),
    "Gaussian jitter, 1 % lost": lambda seed, hours: live(seed, hours, _gauss, 0.01),
    "Gaussian jitter, 5 % lost": lambda seed, hours: live(seed, hours, _gauss, 0.05),
    "1 % come later, by 50 ms on the average (exponential)": lambda seed, hours: live(seed, hours, _tailed),
    "later ones, and 1 % lost": lambda seed, hours: live(seed, hours, _tailed, 0.01),
    "later ones, and 5 % lost": lambda seed, hours: live(seed, hours, _tailed, 0.05),
    "20 in place of 30 pictures a second in each second five minutes": lambda seed, hours: live(
        seed, hours, _gauss, period_s=_darker
    ),
}


def shares_by_drain(runs: int) -> dict[str, list[float]]:
    """Return the share of stalls with which a robot drove on, for each of `DRAINS`."""
    return {
        name: [
            sum(drove_on_old_s(stalled(drain, seed), has_begun) > DROVE_S for seed in range(runs)) / runs
            for drain in DRAINS
        ]
        for name, has_begun in KNOWN.items()
    }


def draw(shares: dict[str, list[float]], file: Path) -> None:
    """Draw the share of stalls over the pace at which they drain."""
    from plots import plt

    figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
    for mark, (name, values) in zip("os", shares.items(), strict=True):
        axes.plot([100 * (drain - 1) for drain in DRAINS], [100 * value for value in values], f"{mark}-", label=name)
    axes.set_xscale("log")
    axes.set_xlabel("what waited drains faster than pictures are captured by, %")
    axes.set_ylabel("drove on, % of stalls")
    axes.grid(color="#dddddd")
    axes.legend()
    figure.savefig(file, metadata={"Date": None})


def main() -> None:
    """Print both tables, and draw the first."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--runs", type=int, default=1000, help="stalls of each pace")
    parser.add_argument("--hours", type=float, default=2.0, help="of each live link")
    parser.add_argument("--plot", type=Path, help="file of the plot")
    arguments = parser.parse_args()
    shares = shares_by_drain(arguments.runs)
    print("| drained at | " + " | ".join(f"{drain:g}" for drain in DRAINS) + " |")
    for name, values in shares.items():
        print(f"| {name} | " + " | ".join(f"{value * arguments.runs:.0f}" for value in values) + " |")
    if arguments.plot:
        draw(shares, arguments.plot)
    print("| link | stops an hour by true ages | MJPEG over HTTP | stood | through FFmpeg | stood |")
    for name, arrivals in LIVE.items():
        counted = [stops(arrivals(1, arguments.hours), has_begun) for has_begun in KNOWN.values()]
        cells = " | ".join(f"{ours / arguments.hours:.1f} | {100 * share:.2f} %" for _, ours, share in counted)
        print(f"| {name} | {counted[0][0] / arguments.hours:.1f} | {cells} |")


if __name__ == "__main__":
    main()
