"""Prove every base of config/follow-ball.toml, or a configuration, and make the table of docs/benchmarks/proof.md.

``make prove`` tries all pairs of faults for each base, two minutes each, and writes the table; ``make prove
ARGS="robot.toml --faults 1"`` proves one configuration and prints its line.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import tempfile
from pathlib import Path

from scenario.prove.proof import Proof, prove
from scenario.prove.watch import BEYOND
from support.ready_bases import FOLLOW_BALL, READY, follow_ball

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "benchmarks" / "proof.md"
ON_SERVOS = "pan-servo with a tilt"
SERVOS = ROOT / "docs" / "robots" / "pan-servo.md"
MARKED = re.compile(r"(<!-- proof -->\n).*?(<!-- end of proof -->\n)", re.DOTALL)
HEADING = (
    "| base | at most | while the program runs and is heard | sequences | asserted by |",
    "| --- | --- | --- | --- | --- |",
)
PAIRS = "scenario/test_prove.py::test_no_two_faults_keep_the_wheels_of_the_ball_follower_turning"
ASSERTED_BY = {
    "gpio-motors": PAIRS,
    "ros-arduino-bridge": PAIRS,
    ON_SERVOS: "scenario/test_prove.py::test_one_fault_of_any_kind_keeps_no_servo_turning",
}
EACH_FAULT = "golden/test_wheels.py::test_wheels_of_every_base_turn_as_they_did"
"""What asserts it of the others, one fault at a time."""
COUNTER_EXAMPLE = Path("counter-example.jsonl")


def configurations() -> dict[str, str]:
    """Return a configuration for each base of the ball follower, and that of a camera on servos, by their names."""
    page = SERVOS.read_text(encoding="utf-8").replace("#tilt", "tilt")
    (on_servos,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    head = FOLLOW_BALL[FOLLOW_BALL.index("[camera]") : FOLLOW_BALL.index("[base]")]
    return {base: follow_ball(base) for base in READY} | {ON_SERVOS: head + on_servos}


def row(name: str, proof: Proof) -> str:
    """Return the row of a proof: the longest time in all, and where the program runs and the base hears it."""
    longest_s = {reason: seconds for reason, (seconds, _) in proof.longest.items()}
    within_s = max((longest_s[reason] for reason in longest_s.keys() - BEYOND), default=0.0)
    cells = f"{max(longest_s.values(), default=0.0):.2f} s | {within_s:.2f} s"
    found = proof.counter_example
    if found is not None and found.violation is not None:
        cells = f"does not hold: {', '.join(map(str, found.sequence)) or 'no fault'}: {found.violation.words} | –"
    return f"| `{name}` | {cells} | {proof.trials:,} of {proof.planned:,} | `{ASSERTED_BY.get(name, EACH_FAULT)}` |"


def main() -> int:
    """Prove; return the exit code, 1 where a limit of one configuration was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", type=Path, nargs="?", help="one configuration, in place of every base")
    parser.add_argument("--faults", type=int, default=2, help="the largest number of faults in a sequence")
    parser.add_argument("--only", action="append", default=[], help="only this fault; may be given several times")
    parser.add_argument("--minutes", type=float, default=math.inf, help="try as many sequences as this allows")
    options = parser.parse_args()
    how = (options.faults, COUNTER_EXAMPLE, options.only)
    if options.config is not None:
        proof = prove(options.config, *how, within_s=60 * options.minutes)
        print(row(options.config.stem, proof))
        return int(proof.counter_example is not None)
    rows = list(HEADING)
    for name, text in configurations().items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.toml"
            path.write_text(text, encoding="utf-8")
            rows.append(row(name, prove(path, *how, within_s=60 * options.minutes)))
        print(rows[-1], flush=True)
    table = "\n".join(rows)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(MARKED.sub(lambda found: f"{found[1]}\n{table}\n\n{found[2]}", page), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
