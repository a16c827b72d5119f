"""The journal: what was known, decided and done in each cycle, one line of JSON a cycle.

The first line says what wrote the journal and holds the configuration; where another one was reloaded while running,
a line holds that. Every further line is one `CycleRecord`, without
the reasons of the rules, which follow from the rest, and without the candidates that were rejected, which decide
nothing. Its rules are ``"as before"`` while none of them changed: with many rules they would be most of each line, and
a run of weeks wears out a memory card. Numbers are written so that reading them gives the same bits again; a recording
replayed through the same rules gives the same decisions. Times are on the run's monotonic clock; the first line says
which wall-clock time the journal began at.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from msgspec import Struct, field
from msgspec.structs import replace
from pydantic_core import from_json

import stadimeter
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.recordings.cycle_json import CycleEncoder, RecordedCycle, reload_json, reload_of
from stadimeter.app.recordings.record_file import RecordFile
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.config.findings import format_value
from stadimeter.config.untrusted_file import lines_of, open_untrusted, sha256_of
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, UnreadableError

__all__ = ["FORMAT", "Journal", "JournalHeader", "JournalWriter", "read_journal"]

FORMAT = 2

_FIRST_BYTES = b'{"stadimeter_journal":'


class JournalHeader(Struct, frozen=True, kw_only=True):
    """The first line of a journal.

    Attributes:
        stadimeter_journal: The version of this format.
        began_at: Wall-clock time of its beginning, ISO 8601.
        files: The texts of the files that the configuration names, by the path that stands in it.
        resumed: What the run restored from an earlier one, as text; empty for nothing.
    """

    stadimeter_journal: int
    version: str
    began_at: str
    configuration: str
    configuration_sha256: str
    files: Mapping[str, str] = field(default_factory=dict)
    resumed: str = ""

    @property
    def recorded_configuration(self) -> RecordedConfiguration:
        """The configuration with all that it needs."""
        return RecordedConfiguration(text=self.configuration, files=self.files)


class JournalWriter:
    """Writes a journal, in the thread of the caller; each line whole or not at all. A `Recorder` does so in a thread.

    An older journal of that name is kept under another one, from the first cycle on: see `RecordFile`.

    Raises:
        JournalError: The file cannot be written, or holds something else than a journal.
    """

    kind = "journal"
    takes_pictures = False

    def __init__(self, path: Path, configuration: RecordedConfiguration, began_at: str | None = None) -> None:
        self._encoder = CycleEncoder(repeats_rules=False)
        self._header = JournalHeader(
            stadimeter_journal=FORMAT,
            version=stadimeter.__version__,
            began_at=began_at or datetime.now(UTC).isoformat(timespec="milliseconds"),
            configuration=configuration.text,
            configuration_sha256=sha256_of(configuration.text),
            files=configuration.files,
        )
        self._file = RecordFile(path, self.kind, lambda head: head[: len(_FIRST_BYTES)] == _FIRST_BYTES[: len(head)])

    def write(self, record: CycleRecord, _frame: Frame | None = None) -> None:
        """Add one cycle; `JournalError` if its line could not be written whole. Earlier ones are intact."""
        self._append(self._encoder.encode(record))

    def note_resumption(self, text: str) -> None:
        """Take in what the run restores from an earlier one. Only before the first cycle."""
        self._header = replace(self._header, resumed=text)

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Add that another configuration was loaded, before the first cycle that it decides."""
        self._append(reload_json(now_s, configuration))

    def older_file(self) -> str:
        """Return in words where an older journal of that name is now; empty if there was none."""
        return self._file.older_file()

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        self._file.close()

    abandon = close

    def _append(self, line: bytes) -> None:
        if self._file.tell() == 0:
            self._file.write(encode(self._header) + b"\n")
        self._file.write(line + b"\n")


class Journal(Struct, frozen=True, kw_only=True):
    """A journal that was read."""

    path: Path
    header: JournalHeader

    def cycles(self) -> Iterator[RecordedCycle]:
        """Yield every cycle, in order.

        Raises:
            JournalError: A configuration that was reloaded while running is damaged, or a line is longer than any
                that is written.
        """
        with readable(self.path) as file:
            lines = lines_of(file)
            next(lines, b"")
            rules = b"[]"
            reloaded = None
            for number, line in enumerate(lines, start=2):
                if not line.endswith(b"\n"):
                    return
                place = f"{self.path}:{number}"
                if taken_over := reload_of(line, place):
                    reloaded = taken_over
                    continue
                cycle = RecordedCycle(line, rules, place, reloaded)
                rules, reloaded = cycle.rules_json, None
                yield cycle

    def is_cut_off(self) -> bool:
        """Check whether the last line is not whole, as after a power cut."""
        with readable(self.path) as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"\n"


@contextmanager
def readable(path: Path) -> Iterator[BinaryIO]:
    """Open a journal or a recording for reading; `JournalError` if it cannot be read, or a line is too long."""
    try:
        with open_untrusted(path) as file:
            yield file
    except UnreadableError as error:
        raise JournalError(str(error)) from error
    except JournalError:
        raise
    except OSError as error:  # a disk that fails
        raise JournalError(f"{path}: {error.strerror or error}") from error


def read_journal(path: Path) -> Journal:
    """Open a journal and read its first line; `JournalError` if that is none, or of a later format."""
    with readable(path) as file:
        line = next(lines_of(file), b"")
    try:
        found = from_json(line)
        version = found["stadimeter_journal"]
    except (ValueError, TypeError, KeyError) as error:
        raise JournalError(f"{path}: not a journal; its first line should hold 'stadimeter_journal'") from error
    if version != FORMAT:
        other = f"a journal of format {format_value(version)}"
        raise JournalError(f"{path}: {other}; this version of stadimeter reads format {FORMAT}")
    try:
        return Journal(path=path, header=decode(line, JournalHeader))
    except ValueError as error:
        raise JournalError(f"{path}:1: damaged first line: {error}") from error
