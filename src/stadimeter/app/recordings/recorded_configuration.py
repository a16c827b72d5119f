"""The configuration of a recording: its text, and the text of the camera file that it names.

A recording is read on another computer, or years later: it must hold all that its rules depend on.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.config.addresses import words_for_people
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import path_from
from stadimeter.config.untrusted_file import CAMERA_FILE_MAX_BYTES, read_untrusted_text
from stadimeter.errors import ConfigError, Problem, UnreadableError

FILE_NAME = "configuration.toml"


class RecordedConfiguration(Struct, frozen=True, kw_only=True):
    """The parts of its configuration that a recording keeps; `files` has the texts of those it names, by path."""

    text: str
    files: Mapping[str, str] = field(default_factory=dict)


def to_be_recorded(configuration: Configuration) -> RecordedConfiguration:
    """Return the parts of a configuration that a recording keeps: its text, and its camera file's if it names one."""
    return RecordedConfiguration(text=configuration.text, files=_camera_files(configuration))


def load_recorded(recorded: RecordedConfiguration, source: Path) -> Configuration:
    """Load the configuration of a recording; a `ConfigError` names the recording."""
    path = source / FILE_NAME  # below a file is no place, so nothing is read there but what was recorded
    try:
        texts = {path_from(path.parent, name): text for name, text in recorded.files.items()}
        loaded = load_configuration(path, texts={**texts, path: recorded.text})
    except ValueError as error:
        if not isinstance(error, ConfigError):  # names that no file can have
            raise ConfigError([Problem(f"its configuration cannot be read: {error}", str(source))]) from error
        inside = f"{source} (its configuration)"
        raise ConfigError(
            replace(problem, file=inside if problem.file == str(path) else problem.file) for problem in error.problems
        ) from error
    return replace(loaded, path=source, text=recorded.text)


def _camera_files(configuration: Configuration) -> dict[str, str]:
    table, texts = tomllib.loads(configuration.text), {}
    for section, key in (("camera", "model"), ("second_camera", "stereo")):
        name = table.get(section, {}).get(key)
        if isinstance(name, str):
            with suppress(UnreadableError):  # it was there when the configuration was loaded
                text = read_untrusted_text(path_from(configuration.path.parent, name), CAMERA_FILE_MAX_BYTES)
                texts[name] = words_for_people(text)
    return texts
