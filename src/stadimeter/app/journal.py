"""The journal: what was known, decided and done in each cycle, one line of JSON a cycle.

The first line says what wrote the journal and holds the configuration. Every further line is one `CycleRecord`, without
the reasons of the rules, which follow from the rest, and without the candidates that were rejected, which decide
nothing. Its rules are ``"as before"`` while none of them changed: with many rules they would be most of each line, and
a run of weeks wears out a memory card. Numbers are written so that reading them gives the same bits again; a recording
replayed through the same rules gives the same decisions. Times are on the run's monotonic clock; the first line says
which wall-clock time the journal began at.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

import stadimeter
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.core.decision import RuleTrace
from stadimeter.errors import JournalError

FORMAT = 1

_RECORD = TypeAdapter(CycleRecord)
_RULES = TypeAdapter(tuple[RuleTrace, ...])
_LEFT_OUT: Mapping[str, bool | set[str]] = {"decision": {"rules", "reasons"}, "rejected": True}
"""What `_RECORD` does not write. The decision comes last in a record, so the rules can be put at the line's end."""
_FIRST_BYTES = b'{"stadimeter_journal":'
_AS_BEFORE = b'"as before"'


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

    An old journal of that name is replaced by the first cycle, and not before: a run whose camera is missing destroys
    nothing.

    Args:
        path: The file.
        configuration: The text of the run's configuration.

    Raises:
        JournalError: The file cannot be written, or holds something else than a journal.
    """

    def __init__(self, path: Path, configuration: str) -> None:
        self._path = path
        self._size = 0
        self._rules: tuple[RuleTrace, ...] | None = None
        self._header = JournalHeader(
            stadimeter_journal=FORMAT,
            version=stadimeter.__version__,
            began_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            configuration=configuration,
            configuration_sha256=sha256_of(configuration),
        )
        try:
            self._file = FileIO(path, "r+" if path.exists() and not path.is_dir() else "w+")
        except OSError as error:
            raise JournalError(f"{path}: the journal cannot be written: {error.strerror or error}") from error
        if not _may_replace(self._file):
            self._file.close()
            raise JournalError(f"{path} holds something else than a journal; choose another file")

    def write(self, record: CycleRecord) -> None:
        """Add one cycle.

        Args:
            record: The cycle.

        Raises:
            JournalError: The line could not be written whole, for a full disk for example. What was written before
                is intact.
        """
        if self._size == 0:
            self._begin()
        self._append(self._line(record))

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        self._file.close()

    def _begin(self) -> None:
        with suppress(OSError):  # a device or pipe has no beginning to go back to
            self._file.seek(0)
            self._file.truncate()
        self._append(_HEADER.dump_json(self._header))

    def _line(self, record: CycleRecord) -> bytes:
        """Return a cycle as JSON."""
        decision = record.decision
        before, self._rules = self._rules, decision.rules
        rules = _AS_BEFORE if decision.rules is before else _RULES.dump_json(decision.rules)
        return b'%b,"rules":%b}}' % (_RECORD.dump_json(record, exclude=_LEFT_OUT)[: -len("}}")], rules)

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


def _may_replace(file: FileIO) -> bool:
    """Return whether a file is empty, a journal, or no file that could hold anything, such as a device."""
    if not file.seekable() or not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return True
    return file.read(len(_FIRST_BYTES)) in {b"", _FIRST_BYTES}


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
            rules = b""
            for number, line in enumerate(file, start=2):
                if not line.endswith(b"\n"):
                    return
                head, key, written = line.rpartition(b',"rules":')
                rules = rules if written.startswith(_AS_BEFORE) else written
                try:
                    yield _RECORD.validate_json(head + key + rules)
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
