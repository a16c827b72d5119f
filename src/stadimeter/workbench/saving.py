"""Saving a configuration and the files beside it: together, each whole, and what was there before is kept.

What a save replaces goes into a folder of its own below `VERSIONS`, beside the configuration. Its number says the
order, since the clock of a Pi without a network may go backwards.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from itertools import dropwhile
from pathlib import Path

from msgspec import Struct

from stadimeter.config.files import (
    CONFIGURATION_MAX_BYTES,
    holds,
    read_untrusted_text,
    refuse_other_than_file,
    write_all_atomically,
    write_atomically,
)
from stadimeter.config.loader import is_demonstration
from stadimeter.errors import ConfigError, DemonstrationError, NotThereError, Problem, UnreadableError, reason_of

# The folder of former versions, beside a configuration.
VERSIONS = "versions"

# The number of versions that are kept; the oldest is deleted first.
KEPT_MAX = 100

_ID = re.compile(r"(\d{4,9})-(\d{8}T\d{6}Z)")
_STAMP = "%Y%m%dT%H%M%SZ"
_PART = r"(?!\.)[^/\x00-\x1f\x7f\ud800-\udfff]+"
_NAME = re.compile(rf"{_PART}(/{_PART})*")


class Version(Struct, frozen=True):
    """The files that a save replaced.

    Attributes:
        id: Its name: a number and when it was replaced.
    """

    folder: Path

    @property
    def id(self) -> str:  # noqa: D102 - see the attributes
        return self.folder.name

    @property
    def number(self) -> int:
        """Number of saves before it, plus one."""
        return int(self.id.partition("-")[0])

    @property
    def unix_s(self) -> float:
        """The time at which it was replaced, since 1970."""
        return datetime.strptime(self.id.partition("-")[2], _STAMP).replace(tzinfo=UTC).timestamp()

    def files(self) -> dict[str, Path]:
        """Return the files that it holds, by name."""
        return {
            file.relative_to(self.folder).as_posix(): file
            for file in sorted(self.folder.rglob("*"))
            if file.is_file() and not file.name.startswith(".")
        }


def check_is_not_ours(configuration: Path) -> None:
    """Raise a `DemonstrationError` for the demonstration's configuration: each start of it shall show the same."""
    if is_demonstration(configuration):
        words = "this configuration is the demonstration's, and stays as it is"
        hint = "for one of your own, end this and run `stadimeter web stadimeter.toml` in a folder of yours"
        raise DemonstrationError([Problem(words, str(configuration), hint=hint)])


def save_files(
    folder: Path, files: Mapping[str, str], check: Callable[[], object] = lambda: None
) -> tuple[tuple[str, ...], Path | None]:
    """Save files: all, or none if one cannot be written. Those that would stay the same are left alone.

    Args:
        files: Their texts, by names below the folder, in the order in which they take their names.
        check: Called first; if it raises, nothing has changed.

    Returns:
        The names of those that were written, and where the ones that were there are kept; None if there were none.

    Raises:
        ConfigError: One cannot be written, or leaves the folder.
    """
    for name in files:
        if not _NAME.fullmatch(name):
            raise ConfigError([Problem("this cannot be the name of a file here", name)])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:  # before anything is read, which of a device may never end
            refuse_other_than_file(Path(os.path.realpath(folder / name)))
        check()
        changed = {name: text for name, text in files.items() if not holds(folder / name, text.encode())}
        present = [name for name in files if (folder / name).exists()] if changed else []
        kept = _keep(folder, present) if present else None
        for name in changed:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_all_atomically({folder / name: text.encode() for name, text in changed.items()})
        for oldest in _all(folder)[:-KEPT_MAX]:
            shutil.rmtree(oldest.folder, ignore_errors=True)
    except UnreadableError:  # what is there, as `check` says it
        raise
    except OSError as error:
        place = folder.joinpath(*list(files)[-1:])
        raise ConfigError([Problem(f"it cannot be written: {reason_of(error)}", str(place))]) from error
    return tuple(changed), kept


def versions(file: Path) -> list[Version]:
    """Return the versions in which a file was kept, newest first."""
    return [each for each in reversed(_all(file.parent)) if (each.folder / file.name).is_file()]


def files_of(file: Path, version: str) -> dict[str, str]:
    """Return the text of a file in one of its versions, and of those that a later save of it replaced with it.

    Raises:
        NotThereError: There is no such version.
        UnreadableError: It cannot be read.
    """
    later = [*dropwhile(lambda each: each.id != version, reversed(versions(file)))]
    if not later:
        raise NotThereError(f"there is no version {version!r} in {file.parent / VERSIONS}")
    found = {name: kept for each in reversed(later) for name, kept in each.files().items()}
    return {name: read_untrusted_text(kept, CONFIGURATION_MAX_BYTES) for name, kept in found.items()}


def _all(folder: Path) -> list[Version]:
    """Return every version below a folder, oldest first."""
    try:
        found = [Version(each) for each in (folder / VERSIONS).iterdir() if _ID.fullmatch(each.name)]
    except OSError:
        return []
    return sorted(found, key=lambda version: version.number)


def _keep(folder: Path, names: list[str]) -> Path:
    """Keep files as a further version; return its folder."""
    before = _all(folder)
    number = before[-1].number + 1 if before else 1
    kept = folder / VERSIONS / f"{number:04}-{datetime.now(UTC).strftime(_STAMP)}"
    for name in names:
        (kept / name).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(kept / name, (folder / name).read_bytes(), like=folder / name)
    return kept
