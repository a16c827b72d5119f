"""The obstacles that keep a valid configuration from running on this computer, as its user sees it."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from glob import has_magic, iglob
from pathlib import Path

from pydantic import BaseModel

from stadimeter.app.bootstrap import build
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding, problems
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import ReportsLacks
from stadimeter.config.toml_lines import KeyPath
from stadimeter.errors import ConfigError, DriverUnavailableError, Problem, StadimeterError


def warnings_here(configuration: Configuration) -> tuple[Problem, ...]:
    """Find what a run would lack here: devices, files, libraries, permissions. No hardware is touched."""
    lacking = problems(_lacking(configuration), str(configuration.path), configuration.spans)
    return (*lacking, *_why_not_built(configuration))


_ELSEWHERE = "if it runs on another computer, add --elsewhere"


def _lacking(configuration: Configuration) -> Iterator[Finding]:
    lacking: dict[str, list[KeyPath]] = defaultdict(list)
    for at, part in configuration.drivers.items():
        for lack in part.options.lacks() if isinstance(part.options, ReportsLacks) else ():
            lacking[lack].append(at)
    for lack, parts in lacking.items():  # what several parts lack is said once
        names = " and ".join(f"'{at[-1]}'" for at in parts)
        yield Finding(parts[0], f"{names} cannot work on this computer: {lack}", _ELSEWHERE, "driver-lacks")
    for at, part in configuration.drivers.items():
        yield from _missing_files(at, part.options)
    if configuration.web is not None:
        yield from _missing_files(("web",), configuration.web)
    if configuration.black_box is not None and (trouble := missing("record")):
        yield Finding(("black_box",), f"the black box cannot write: {trouble}", _ELSEWHERE, "driver-lacks")


def _missing_files(at: KeyPath, options: BaseModel) -> Iterator[Finding]:
    """Find the files that options name to be read, and that are not there or not for this user."""
    for name, field in type(options).model_fields.items():
        value = getattr(options, name)
        is_list = isinstance(value, tuple)  # of files, folders and patterns, as of the camera `images`
        for path in value if is_list else (value,):
            if isinstance(path, Path) and (trouble := _file_trouble(path, may_be_several=is_list)):
                yield Finding((*at, field.alias or name), trouble, _ELSEWHERE, "driver-lacks")


def _file_trouble(path: Path, *, may_be_several: bool) -> str:
    """Return why a file cannot be read, or a folder or the files of a pattern; empty if they can."""
    try:
        if path.is_file() or (may_be_several and path.is_dir()):
            return "" if os.access(path, os.R_OK) else f"this user may not read {path}"
        if may_be_several and has_magic(str(path)) and any(iglob(str(path), recursive=True)):  # noqa: PTH207 - may be absolute
            return ""
    except OSError as error:
        return f"{path} cannot be looked at: {error.strerror}"
    return f"there is no file {path}"


def _why_not_built(configuration: Configuration) -> tuple[Problem, ...]:
    """Return why a run would not begin. A library that is missing is left out: its driver has said so."""
    try:
        build(configuration)
    except ConfigError as error:
        return tuple(error.problems)
    except DriverUnavailableError:
        return ()
    except StadimeterError as error:
        words = f"`stadimeter run` refuses this: {error}"
        return (Problem(words, file=str(configuration.path), code="will-not-run"),)
    return ()
