"""The configuration of a recording: its text, and the text of the camera file that it names.

A recording is read on another computer, or years later: it must hold all that its rules depend on.
"""

from __future__ import annotations

import hashlib
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from stadimeter.config.addresses import words_for_people
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import path_from
from stadimeter.config.untrusted_file import CAMERA_FILE_MAX_BYTES, read_untrusted_text
from stadimeter.errors import ConfigError, Problem, UnreadableError

FILE_NAME = "configuration.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedConfiguration:
    """What a recording keeps of its configuration; `files` has the texts of those it names, by path."""

    text: str
    files: Mapping[str, str] = field(default_factory=dict)


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def to_be_recorded(configuration: Configuration) -> RecordedConfiguration:
    """Return what a recording keeps of a configuration: its text, and that of its camera file if it names one."""
    return RecordedConfiguration(text=configuration.text, files=_camera_files(configuration))


def load_recorded(recorded: RecordedConfiguration, source: Path) -> Configuration:
    """Load the configuration of a recording; a `ConfigError` names the recording."""
    with tempfile.TemporaryDirectory(prefix="stadimeter-") as name:
        try:
            path = _laid_out(recorded, Path(name).resolve())
        except (OSError, ValueError) as error:  # names that no file can have
            raise ConfigError([Problem(f"its configuration cannot be laid out: {error}", str(source))]) from error
        try:
            loaded = load_configuration(path)
        except ConfigError as error:
            inside = f"{source} (its configuration)"
            raise ConfigError(
                replace(problem, file=inside if problem.file == str(path) else problem.file)
                for problem in error.problems
            ) from error
    return replace(loaded, path=source, text=recorded.text)


def _camera_files(configuration: Configuration) -> dict[str, str]:
    model = tomllib.loads(configuration.text).get("camera", {}).get("model")
    if not isinstance(model, str):
        return {}
    try:
        text = read_untrusted_text(path_from(configuration.path.parent, model), CAMERA_FILE_MAX_BYTES)
    except UnreadableError:  # it was there when the configuration was loaded
        return {}
    return {model: words_for_people(text)}


def _laid_out(recorded: RecordedConfiguration, top: Path) -> Path:
    """Write the files as they stood to each other, below a folder, and return where the configuration is."""
    depth = max((Path(name).parts.count("..") for name in recorded.files), default=0)
    folder = top.joinpath(*["folder"] * depth)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in recorded.files.items():
        file = path_from(folder, name).resolve()
        if file.is_relative_to(top):  # another place was written out whole, and is looked for there
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, "utf-8")
    path = folder / FILE_NAME
    path.write_text(recorded.text, "utf-8")
    return path
