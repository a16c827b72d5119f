"""The command ``prove``: whether a few faults at once can keep the wheels turning."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from stadimeter.app.exact_json import plain
from stadimeter.cli.check import prose_console
from stadimeter.cli.exits import NOT_FOUND, ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.progress import working
from stadimeter.workbench.prove.faults import FaultSequence
from stadimeter.workbench.prove.proof import FIRST_AT_S, MOMENTS_S, Proof, prove
from stadimeter.workbench.prove.trial import AFTERWARDS_S
from stadimeter.workbench.prove.watch import BEYOND, SINCE

COUNTER_EXAMPLE = Path("counter-example.jsonl")

_HOW_MANY = ("", "single fault keeps", "two faults keep", "three faults keep")


def prove_command(
    config: ConfigArgument = None,
    faults: Annotated[
        int, typer.Option("--faults", min=1, max=3, metavar="N", help="The largest number of faults in a sequence.")
    ] = 2,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="FAULT", help="Only this fault; may be given several times.")
    ] = None,
    minutes: Annotated[
        float,
        typer.Option("--minutes", min=0, metavar="N", help="Try as many sequences as this allows, and say how many."),
    ] = math.inf,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Try every sequence of a few faults, and see whether the wheels stop.

    Nothing real is opened and nothing moves: the rules, safety, leases and the driver of the base run as in `run`, on a
    clock that is stepped, against the emulated firmware of the base. In each run the robot follows its target, and the
    faults come at every one of a few moments. It ends with the longest time for which the wheels turned, or with a
    sequence that broke a limit, as a journal for `replay`. This is a bounded proof by exhaustive simulation, not a
    certificate: docs/safety.md says what it covers.

    **Examples**

    - `stadimeter prove config/follow-ball.toml`

    - `stadimeter prove config/follow-ball.toml --faults 1 --only unplug-base --only hide-target`

    **Exit code**: 0 every limit held; 1 a sequence broke one; 2 the configuration is wrong, or there is nothing to
    prove.
    """
    with plain_errors(), working("proving") as say:
        proof = prove(
            configuration_path(config),
            faults,
            COUNTER_EXAMPLE,
            only or (),
            tell=lambda done, total: say(f"proving: {done} of {total} runs"),
            within_s=60 * minutes,
        )
    if as_json:
        typer.echo(json.dumps(plain(proof), ensure_ascii=False))
    else:
        _tell(proof)
    if proof.counter_example is not None:
        raise typer.Exit(NOT_FOUND)


def _tell(proof: Proof) -> None:
    console = prose_console()
    moments = ", ".join(f"{moment_s:g}" for moment_s in MOMENTS_S)
    console.print(
        f"{proof.trials} of {proof.planned} sequences, {proof.simulated_s / 3600:.1f} h of the robot's time. Faults: "
        f"{', '.join(proof.alphabet)}. The first comes at {FIRST_AT_S:g} s, while the robot drives; others {moments} s "
        f"after it. Each run goes on until the robot drives again or stands for good, {AFTERWARDS_S:g} s after the "
        "last fault at most. Not covered: other moments and durations, pictures and detectors, a program and "
        "its watchdog process that die at once on a base without a time-out, and mechanics. A bounded proof by "
        "exhaustive simulation, not a certificate.",
        markup=False,
    )
    for reason, (seconds, sequence) in sorted(proof.longest.items()):
        console.print(f"  {seconds:.2f} s at most after {SINCE[reason]}: {_in_words(sequence)}", markup=False)
    found = proof.counter_example
    if found is not None and found.violation is not None:
        console.print(Text(f"Counter-example: {_in_words(found.sequence)}", "bold red"))
        console.print(f"  at {found.violation.at_s:.2f} s {found.violation.words}", markup=False)
        console.print(f"  look at it: stadimeter replay {COUNTER_EXAMPLE}", markup=False)
        return
    longest_s = {reason: seconds for reason, (seconds, _) in proof.longest.items()}
    within_s = max((longest_s[reason] for reason in longest_s.keys() - BEYOND), default=0.0)
    is_sample = proof.trials < proof.planned
    which = f"None of these {proof.trials} sequences keeps" if is_sample else f"No {_HOW_MANY[proof.faults_max]}"
    words = (
        f"{which} the {proof.parts} turning longer than {max(longest_s.values()):.2f} s; "
        f"{within_s:.2f} s where the program runs and the base hears it."
    )
    console.print(Text(words, "bold green"))


def _in_words(sequence: FaultSequence) -> str:
    return ", ".join(map(str, sequence)) or "no fault"
