"""The commands ``site …``: certify what a camera measures where it is, and see whether it is still where it was."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import typer

from stadimeter.app.exact_json import encode, plain
from stadimeter.app.places import CERTIFICATE
from stadimeter.cli.completion import complete_target
from stadimeter.cli.exits import DONE, NOT_FOUND, ConfigArgument, configuration_path, plain_errors, say_note
from stadimeter.cli.operate import confirm
from stadimeter.cli.target_options import Option, ask_until, give_up, parse_known_length, takes_options
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import split_spread
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.workbench.site import (
    WATCH_S,
    SiteSession,
    check_view,
    describe_placement,
    describe_reliance,
    save_view,
    summary_of,
)

SKIP = "skip"

site = typer.Typer(no_args_is_help=True, rich_markup_mode="markdown")


@site.callback()
def _site() -> None:
    """Check how right distances are at this place, and whether the camera has moved."""


@site.command()
@takes_options()
def save(config: ConfigArgument = None, *, as_json: bool = False) -> None:
    """Save the view that a fixed camera has now, as that of its mounting; `site certify` does it too.

    Takes a dozen pictures, through the run if one has the camera, and keeps a few hundred features of what stands
    still: where each is and how it looks in 256 bits. No picture is kept. The file stands beside the configuration,
    with the ending `.mounting`. A run compares with it once a minute, from its next start on.

    **Example**

    - `stadimeter site save appliance.toml`

    **Exit code**: 0 saved; 2 the view has too little to go by, such as a white wall, or the camera gives no picture.
    """
    with plain_errors():
        path, reference = save_view(_loaded(config))
        features = len(reference.views[0].features)
        told = json.dumps({"file": str(path), "features": features})
        typer.echo(told if as_json else f"{path}: {features} features that stand still")


@site.command()
@takes_options()
def check(config: ConfigArgument = None, *, as_json: bool = False) -> None:
    """Compare the view that the camera has now with the saved one, once.

    Prints the turn (pan to the right, tilt up, roll with the right side down), the zoom and the blur, each with its
    standard deviation. A run wants two such findings in a row before it says anything. With --json, one object:
    findings (by their kinds, empty for as saved), not_judged, and motion (in radians, with its sigmas) and blur_px2 as
    compared, which is null where nothing is recognised.

    **Example**

    - `stadimeter site check appliance.toml`

    **Exit code**: 0 as saved; 1 not so, or it cannot be judged; 2 no view was saved, or the camera gives no picture.
    """
    with plain_errors():
        found = check_view(_loaded(config))
        words = f"not as saved ({', '.join(found.found)})" if found.found else found.not_judged or "as saved"
        compared = None if found.best is None else plain(found.best)
        told = json.dumps({"findings": found.found, "not_judged": found.not_judged, "compared": compared})
        words = f"{words}: {found.best.in_words()}" if found.best is not None else words
        typer.echo(told if as_json else words)
    raise typer.Exit(NOT_FOUND if found.found or found.not_judged else DONE)


site.command("confirm", help=confirm.__doc__)(confirm)


def _loaded(config: Path | None) -> Configuration:
    return load_configuration(configuration_path(config), with_tests=False)


@site.command()
@takes_options(
    at=Option("DISTANCE", "Where to put the target: --at 50cm,1m,2m, or given repeatedly."),
    pictures=Option("PATH", "Pictures taken at each --at: a folder or a pattern for each."),
    tape=Option("LENGTH", "How well a placement is known: one standard deviation."),
    seconds=Option("", "How long to watch at each distance.", limits=(0.1, 60.0)),
    name=Option("NAME", "The target to certify with; else the first.", flags="--target", completes=complete_target),
    anew=Option("", "Forget what an earlier, unfinished measurement left."),
)
def certify(
    config: ConfigArgument = None,
    *,
    at: list[str] | None = None,
    pictures: list[Path] | None = None,
    tape: str = "2mm",
    seconds: float = WATCH_S,
    name: str = "",
    anew: bool = False,
    as_json: bool = False,
) -> None:
    """Certify how right distances are at this place, in this light, and which thresholds that carries.

    Asks for the target at five distances, from 50 cm to the farthest that a rule uses. Measure each with a tape, from
    the lens to the target's nearest point, and keep everything still while the camera watches for some seconds; a run
    that has the camera goes on. From all of them follow an error of the scale, the smallest one that would have been
    found, an offset, the scatter and the farthest reliable distance.

    Writes CONFIG.certificate.json and .html beside the configuration, and saves the view of a fixed camera.
    `stadimeter check` then says which threshold the site does not carry, and when the lens or the size of the target
    has changed since. What was measured is kept after each distance; the same command goes on after an interruption.

    Before a simulated camera the program places the target itself. With --json, the certificate is printed as it is
    written, and what is said meanwhile goes to standard error.

    **Examples**

    - `stadimeter site certify stadimeter.toml`

    - `stadimeter site certify stadimeter.toml --at 50cm,1m,2m --pictures near --pictures middle --pictures far`

    **Exit code**: 0 the certificate was written; 1 the target was not seen at a distance, or moved, or it was stopped;
    2 an option or a file is wrong, or the distances are too few.
    """
    with plain_errors():
        path = configuration_path(config)
        session = SiteSession(load_configuration(path), name, anew=anew)
        distances = [part.strip() for text in at or [] for part in text.split(",")]
        tape_m = parse_known_length(tape, "--tape")
        for each in session.certificate.placements:
            say_note(f"going on; {each.tape_m:g} m was measured before {session.certificate.date}: --anew forgets it")
        with redirect_stdout(sys.stderr if as_json else sys.stdout):
            is_seen = _take_all(session, distances, pictures or [], tape_m, seconds)
            made = session.finish()
            for words in (*summary_of(made), *map(describe_reliance, session.site.reliances(made))):
                typer.echo(words)
            typer.echo(f"wrote {path.with_suffix(CERTIFICATE)}, and .html beside it")
        if as_json:
            typer.echo(encode(made).decode())
    raise typer.Exit(DONE if is_seen else NOT_FOUND)


def _take_all(
    session: SiteSession, asked: Sequence[str], pictures: Sequence[Path], tape_m: float, for_s: float
) -> bool:
    """Measure at every distance that is left; return whether the target was seen at each."""
    wanted_m = [parse_known_length(each, "--at") for each in asked] or session.propose_m()
    if pictures and len(pictures) != len(asked):
        raise ConfigError(f"--pictures is given {len(pictures)} times and --at names {len(asked)} distances")
    if len(set(wanted_m)) < len(wanted_m):
        raise ConfigError("--at names a distance twice, and it says the same each time; give each once")
    if not pictures and not session.is_simulated:
        typer.echo("Measure with a tape, from the lens to the target's nearest point. Keep the camera still.")
        seen = [_take_asking(session, tape_m, for_s, each_m) for each_m in wanted_m]
    else:
        folders: Sequence[Path | None] = pictures or [None] * len(wanted_m)
        seen = [_take(session, tape_m, for_s, *each) for each in zip(wanted_m, folders, strict=True)]
    return all(seen)


def _take(session: SiteSession, tape_m: float, for_s: float, at_m: float, pictures: Path | None) -> bool:
    """Measure at a distance and print what was seen; return whether that says where the target is."""
    placed = session.take(at_m, tape_m, for_s, pictures)
    words = describe_placement(placed)
    typer.echo(words if placed.is_read else f"error: {words}", err=not placed.is_read)
    return placed.is_read


def _take_asking(session: SiteSession, tape_m: float, for_s: float, at_m: float) -> bool:
    """Ask for the target at a distance until it is seen there, or the person goes on without."""

    def ask() -> str:
        typer.echo(f"Put it at {at_m:g} m.")
        return "Enter when it is there; or type its distance, such as 1.52 m ± 3 mm; or skip: "

    def take(answer: str) -> bool:
        if answer == SKIP:
            return False
        length, sigma = split_spread(answer)
        there_m = parse_known_length(length, "the distance") if length else at_m
        placed = session.take(there_m, parse_known_length(sigma, "the ±") if sigma else tape_m, for_s)
        if not placed.is_read:
            raise CalibrationError(describe_placement(placed))
        typer.echo(describe_placement(placed))
        return True

    return ask_until(ask, lambda _: give_up("stopped; what was measured is kept, and the same command goes on"), take)
