"""The journal: what was known, decided and done in each cycle, one line of JSON a cycle.

The first line says what wrote the journal and holds the configuration. Every further line is one `CycleRecord`. Numbers
are written so that reading them gives the same bits again; a recording replayed through the same rules gives the same
decisions. Times are on the run's monotonic clock; the first line says which wall-clock time the journal began at.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

import stadimeter
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.errors import JournalError

FORMAT = 1

_RECORD = TypeAdapter(CycleRecord)


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalHeader:
    """The first line of a journal.

    Attributes:
        stadimeter_journal: The version of this format.
        version: The version of stadimeter that wrote it.
        began_at: Wall-clock time of its beginning, ISO 8601.
        configuration: The text of the configuration.
        configuration_sha256: Its SHA-256, in hexadecimal.
    """

    stadimeter_journal: int
    version: str
    began_at: str
    configuration: str
    configuration_sha256: str


_HEADER = TypeAdapter(JournalHeader)


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text in hexadecimal.

    Args:
        text: The text.

    Returns:
        64 hexadecimal digits.
    """
    return hashlib.sha256(text.encode()).hexdigest()


class JournalWriter:
    """Writes a journal. Each line is written whole or not at all.

    Args:
        path: The file; an old one of that name is replaced.
        configuration: The text of the run's configuration.

    Raises:
        JournalError: The file cannot be written.
    """

    def __init__(self, path: Path, configuration: str) -> None:
        self._path = path
        self._size = 0
        header = JournalHeader(
            stadimeter_journal=FORMAT,
            version=stadimeter.__version__,
            began_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            configuration=configuration,
            configuration_sha256=sha256_of(configuration),
        )
        try:
            self._file = FileIO(path, "w")
        except OSError as error:
            raise JournalError(f"{path}: the journal cannot be written: {error.strerror or error}") from error
        self._append(_HEADER.dump_json(header))

    def write(self, record: CycleRecord) -> None:
        """Add one cycle.

        Args:
            record: The cycle.

        Raises:
            JournalError: The line could not be written whole, for a full disk for example. What was written before
                is intact.
        """
        self._append(_RECORD.dump_json(record))

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        self._file.close()

    def _append(self, line: bytes) -> None:
        data = line + b"\n"
        try:
            written = self._file.write(data)
        except OSError as error:
            self._drop_fragment()
            raise JournalError(f"{self._path}: {error.strerror or error}; the journal ends here, intact") from error
        if written != len(data):
            self._drop_fragment()
            raise JournalError(f"{self._path}: the disk is full; the journal ends here, intact")
        self._size += len(data)

    def _drop_fragment(self) -> None:
        with suppress(OSError):  # a device or pipe cannot be cut; the reader skips a line that is not whole
            os.ftruncate(self._file.fileno(), self._size)
        self._file.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """A journal that was read.

    Attributes:
        path: The file.
        header: Its first line.
    """

    path: Path
    header: JournalHeader

    def records(self) -> Iterator[CycleRecord]:
        """Yield every cycle, in order.

        Yields:
            The cycles.

        Raises:
            JournalError: A line is damaged. A last line that was cut off is not an error: the recording ended there.
        """
        with self.path.open("rb") as file:
            next(file)
            for number, line in enumerate(file, start=2):
                if not line.endswith(b"\n"):
                    return
                try:
                    yield _RECORD.validate_json(line)
                except ValidationError as error:
                    raise JournalError(f"{self.path}:{number}: not a cycle of a journal: {_first(error)}") from error

    def is_cut_off(self) -> bool:
        """Return whether the last line is not whole, as after a power cut."""
        with self.path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"\n"


def read_journal(path: Path) -> Journal:
    """Open a journal and read its first line.

    Args:
        path: The file.

    Returns:
        The journal.

    Raises:
        JournalError: It cannot be read, or is no journal, or one of a later format.
    """
    try:
        with path.open("rb") as file:
            line = file.readline()
    except OSError as error:
        raise JournalError(f"{path}: {error.strerror or error}") from error
    try:
        found = json.loads(line)
        version = found["stadimeter_journal"]
    except (ValueError, TypeError, KeyError) as error:
        raise JournalError(f"{path}: not a journal; its first line should hold 'stadimeter_journal'") from error
    if version != FORMAT:
        raise JournalError(f"{path}: a journal of format {version}; this version of stadimeter reads format {FORMAT}")
    try:
        return Journal(path=path, header=_HEADER.validate_python(found))
    except ValidationError as error:
        raise JournalError(f"{path}:1: damaged first line: {_first(error)}") from error


def _first(error: ValidationError) -> str:
    detail = error.errors()[0]
    place = ".".join(str(part) for part in detail["loc"])
    return f"{place}: {detail['msg']}" if place else detail["msg"]
