"""How well a base follows a ball, through the whole program in a simulated world. Run it for the tables of the page.

`--walks N` makes N random walks of 5 min instead, each in about 6 s; `--paths N` lets N balls swing and sway in
different ways.
"""

from __future__ import annotations

import argparse
import tempfile
from itertools import product
from pathlib import Path
from statistics import median

from support.following import (
    BASES,
    EventfulWalk,
    Moment,
    follow,
    is_within_limits,
    out_of_sight_s,
    rms,
    seen_again_s,
    stands,
    swaying_path,
    sways,
    walks_away,
)

LATENCIES_MS = (30, 190)
WALK_S = 300.0


def gap_rms_m(moments: list[Moment], from_s: float) -> float:
    """Return the error of the gap of 1 m, from a time on."""
    return rms([each.gap_m - 1 for each in moments if each.at_s > from_s])


def row(folder: Path, base: str, latency_ms: float) -> str:
    """Return a row of the table of figures."""
    step = follow(folder, 12, stands(1.5), base=base, latency_ms=latency_ms)
    settled_s = max((each.at_s for each in step if abs(each.gap_m - 1) > 0.1), default=0.0)
    over = max(0.0, 1 - min(each.gap_m for each in step))
    away = follow(folder, 15, walks_away, base=base, latency_ms=latency_ms)
    to_and_fro = follow(folder, 35, sways, base=base, latency_ms=latency_ms)
    nearest_m = min(each.gap_m for each in to_and_fro)
    return (
        f"| {base}, {latency_ms:g} ms | {settled_s:.1f} s, {over / 0.5:.0%} | {gap_rms_m(step, 6):.1%} | "
        f"{100 * gap_rms_m(away, 5):.1f} cm | {gap_rms_m(to_and_fro, 5):.2f} m, {nearest_m:.2f} m |"
    )


def print_paths(folder: Path, paths: int) -> None:
    """Print how the gap errs beside balls that swing and sway in different ways."""
    for base, latency_ms in product(BASES, LATENCIES_MS):
        runs = [follow(folder, 35, swaying_path(seed), base=base, latency_ms=latency_ms) for seed in range(paths)]
        errors_m = sorted(gap_rms_m(moments, 5) for moments in runs)
        share = sum(error_m <= 0.10 for error_m in errors_m) / paths
        nearest_m = min(each.gap_m for moments in runs for each in moments)
        print(
            f"| {base}, {latency_ms} ms | {median(errors_m):.3f} m | {errors_m[int(0.9 * paths)]:.3f} m | "
            f"{errors_m[-1]:.3f} m | {share:.0%} | {nearest_m:.2f} m |",
            flush=True,
        )


def print_walks(folder: Path, walks: int) -> None:
    """Print how random walks went, and how soon the ball was in view again after it was hidden, or had left it."""
    hidden_s, gone_s, nearest_m = [], [], []
    for seed in range(walks):
        walk = EventfulWalk(seed, WALK_S)
        moments = follow(folder, WALK_S, walk, latency_ms=LATENCIES_MS[seed % 2], hidden=walk.is_hidden)
        hidden_s += [seen_again_s(moments, at_s) for at_s in walk.hidden_s]
        gone_s += [seen_again_s(moments, at_s) for at_s in walk.leaves_s]
        nearest_m.append(min(each.gap_m for each in moments))
        spans_s = [round(span_s, 2) for span_s in out_of_sight_s(moments)]
        limits = "within limits" if is_within_limits(moments) else "OVER A LIMIT"
        print(f"walk {seed}: nearest {nearest_m[-1]:.2f} m, {limits}, out of sight {spans_s}", flush=True)
    print(f"nearest: median {median(nearest_m):.2f} m, worst {min(nearest_m):.2f} m")
    for name, spans_s, limit_s in (("hidden for 1 s", hidden_s, 1.5), ("left the view", gone_s, 8.0)):
        share = sum(span_s <= limit_s for span_s in spans_s) / len(spans_s)
        never = spans_s.count(0.0)
        print(
            f"{name}, {len(spans_s)} times, {never} of them never lost: in view again within {limit_s:g} s in "
            f"{share:.1%}, median {median(spans_s):.2f} s, worst {max(spans_s):.2f} s"
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walks", type=int, default=0)
    parser.add_argument("--paths", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.paths:
            print_paths(folder, arguments.paths)
        elif arguments.walks:
            print_walks(folder, arguments.walks)
        else:
            for base, latency_ms in product(BASES, LATENCIES_MS):
                print(row(folder, base, latency_ms))


if __name__ == "__main__":
    main()
