"""The journal: what was known, decided and done in each cycle, one line of JSON a cycle; and a cycle as JSON.

The first line says what wrote the journal and holds the configuration; where another one was reloaded while running,
a line holds that. Every further line is one `CycleRecord`, without the reasons of the rules, which follow from the
rest, and without the candidates that were rejected, which decide nothing. Numbers are written so that reading them
gives the same bits again; a recording replayed through the same rules gives the same decisions. Times are on the run's
monotonic clock; the first line says which wall-clock time the journal began at.
"""

from __future__ import annotations

import fcntl
import os
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import FileIO
from itertools import count
from pathlib import Path
from typing import BinaryIO, TypeVar

from msgspec import Raw, Struct, field
from msgspec.structs import replace
from pydantic_core import from_json

import stadimeter
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import decode, encode
from stadimeter.config.addresses import words_for_people
from stadimeter.config.files import (
    CAMERA_FILE_MAX_BYTES,
    lines_of,
    open_untrusted,
    read_untrusted_text,
    rename_to_free_name,
    sha256_of,
)
from stadimeter.config.findings import format_value
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import path_from
from stadimeter.core.bounds import MAX_TIME_S, is_time
from stadimeter.core.decision import Decision
from stadimeter.core.frame import Frame
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError, JournalError, Problem, UnreadableError

# A file that grows by whole records. An older one of that name is kept under another, and no record is cut in half ----
#
# Losing what was recorded is worse than an untidy folder: a service that crashes is started again at once, with the
# same file name, and the record of the crash must survive that. So nothing that holds a record is ever overwritten
# or deleted.

# The length of the beginning of a file that tells whose it is.
HEAD_BYTES = 4096

# Of recordings with pictures.
ENDING = ".mcap"


class RecordFile:
    """A file that grows by whole records. The writer of the library ``mcap`` takes it for a file, too.

    The data of one `write` is written whole or not at all. The file is made with the first record, and not before: a
    run whose camera is missing renames nothing. An older file of that name gets another name then. Only the user can
    read a new file.

    A character device such as ``/dev/null`` will do as well. A pipe will not: its reader could hold up the writer.

    Args:
        kind: Its name in messages, such as ``journal``.
        is_ours: Decides from the first bytes of a file, up to 4 KiB, whether it is of that kind, or may have become
            one if a power cut had not ended it.

    Attributes:
        kept_as: The new name of the older file; None if there was none.

    Raises:
        JournalError: It cannot be written, or holds something else than one of that kind.
    """

    def __init__(self, path: Path, kind: str, is_ours: Callable[[bytes], bool]) -> None:
        self.kept_as: Path | None = None
        self._path = path
        self._real_path = Path(os.path.realpath(path))
        self._kind = kind
        self._is_ours = is_ours
        self._size = 0
        self._file: FileIO | None = None
        self._refuse_other()
        folder = self._real_path.parent
        if not self._real_path.is_char_device() and not os.access(folder, os.W_OK | os.X_OK):
            why = f"its folder {folder} cannot be written" if folder.is_dir() else f"there is no folder {folder}"
            raise JournalError(f"{path}: the {kind} cannot be written: {why}")

    def write(self, data: bytes) -> int:
        """Write some records whole; return how many bytes that was. `JournalError` leaves the earlier ones intact."""
        file = self._file or self._begin()
        try:
            rest = memoryview(data)
            while rest:  # a disk that fills up takes a part of it, and says why with the next part
                rest = rest[file.write(rest) :]
        except OSError as error:
            with suppress(OSError):  # a device cannot be cut; the reader stops where a record is not whole
                os.ftruncate(file.fileno(), self._size)
            file.close()
            raise self._failure(error, after=f"; the {self._kind} ends here, intact") from error
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._size

    def flush(self) -> None:
        """Do nothing: what was written is with the operating system already."""

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        if self._file is not None:
            self._file.close()

    def older_file(self) -> str:
        """Return in words where an older file is now; empty if there was none."""
        return f"{self._path} held an older {self._kind}, which is now {self.kept_as}" if self.kept_as else ""

    def _refuse_other(self) -> None:
        """Raise `JournalError` for what is there and is neither of our kind nor empty."""
        path = self._real_path
        try:
            if path.is_file():
                with open_untrusted(path) as file:
                    head = file.read(HEAD_BYTES)
                is_usable = self._is_ours(head) or not head.strip(b"\0")  # a power cut may leave zeros
            else:
                is_usable = path.is_char_device() or not os.path.lexists(path)
        except OSError as error:
            raise self._failure(error) from error
        if not is_usable:
            raise JournalError(f"{self._path} holds something else than a {self._kind}; choose another file")

    def _begin(self) -> FileIO:
        """Make the file, after what has the name got another one. Another run may have made one since."""
        path, flags = self._real_path, os.O_WRONLY | os.O_CLOEXEC | os.O_NOCTTY
        try:
            if not path.is_char_device():
                self._refuse_other()
                flags |= os.O_CREAT | os.O_EXCL
            while True:
                try:
                    self._file = FileIO(os.open(path, flags, 0o600), "w")
                except FileExistsError:
                    numbered = (f"{path.stem}-{number}{path.suffix}" for number in count(1))
                    self.kept_as = rename_to_free_name(path, numbered)
                else:
                    with suppress(OSError):  # this file system has no locks
                        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the list of recordings asks for it
                    return self._file
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError, after: str = "") -> JournalError:
        before = "" if after else f"the {self._kind} cannot be written: "
        return JournalError(f"{self._path}: {before}{error.strerror or error}{after}")


def delete_old(folder: Path, keep_s: float, folder_bytes: float, names: str = f"*{ENDING}", newest: str = "") -> None:
    """Delete the recordings of a folder that ended longer ago, and the oldest while all together are too large.

    Args:
        names: Which files are meant.
        newest: The one that is being written, however the clock was set meanwhile.
    """
    found = ((file.stat(), file) for file in folder.glob(names))
    newest_first = sorted(found, key=lambda each: (each[1].name != newest, -each[0].st_mtime))
    total_bytes = 0
    for about, file in newest_first:
        total_bytes += about.st_size
        if file.name != newest and (total_bytes > folder_bytes or time.time() - about.st_mtime > keep_s):
            file.unlink(missing_ok=True)


# The first bytes of an MCAP file, and its last ones if it was finished.
MAGIC = b"\x89MCAP0\r\n"

# How the name of the program begins that recordings say they were written by.
LIBRARY = "stadimeter"


def begins_as_mcap(head: bytes) -> bool:
    """Check whether a file is an MCAP file, or the beginning of one that a cut ended too early to tell."""
    return MAGIC.startswith(head[: len(MAGIC)])


_T = TypeVar("_T")

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


class _RecordedReload(Struct, frozen=True):
    """A configuration that was reloaded while running, and when on the run's monotonic clock."""

    at_s: float
    configuration: RecordedConfiguration


class _Reloaded(Struct, frozen=True):
    reloaded: _RecordedReload


# The parts of a cycle before its decision, and those of a decision, in their order.
_PARTS = ("observation", "applied", "timings_s")
_DECIDED = tuple(name for name in Decision.__struct_fields__ if name != "reasons")

_RELOADED_BEGINS = b'{"reloaded":'


def reload_json(at_s: float, configuration: RecordedConfiguration) -> bytes:
    """Write that another configuration was reloaded, on one line before the first cycle that it decided."""
    return encode(_Reloaded(_RecordedReload(at_s, configuration)))


def reload_of(line: bytes, place: str) -> RecordedConfiguration | None:
    """Return the configuration that a line says was reloaded; None if it says no such thing."""
    if not line.startswith(_RELOADED_BEGINS):
        return None
    try:
        return decode(line, _Reloaded).reloaded.configuration
    except ValueError as error:
        raise JournalError(f"{place}: not a configuration: {error}") from error


def cycle_json(record: CycleRecord) -> bytes:
    """Write a cycle on one line, without what follows from the rest or decides nothing."""
    decided = {name: getattr(record.decision, name) for name in _DECIDED}
    return encode({**{name: getattr(record, name) for name in _PARTS}, "decision": decided})


class _When(Struct, frozen=True):
    """The parts of an observation that tell when it was."""

    now_s: float
    frame: Raw


class _Parts(Struct, frozen=True):
    observation: Raw
    decision: Raw


class RecordedCycle:
    """One cycle of a recording, read as far as it is asked for. A part that is damaged raises `JournalError`.

    Attributes:
        reloaded: The configuration that was reloaded right before it.
    """

    __slots__ = ("_line", "_parts", "_place", "reloaded")

    def __init__(self, line: bytes, place: str, reloaded: RecordedConfiguration | None = None) -> None:
        self.reloaded = reloaded
        self._line = line
        self._place = place
        self._parts: _Parts | None = None

    def observation(self) -> Observation:
        """Return the observation of the cycle."""
        observation = self._read(self._part("observation"), Observation)
        captured_s = [measured.captured_at_s for measured in observation.measurements]
        if observation.frame is not None:
            captured_s.append(observation.frame.captured_at_s)
        if not is_time(observation.now_s, *captured_s):
            words = f"a time beyond {MAX_TIME_S:g} s, which no clock shows"
            raise JournalError(f"{self._place}: not a cycle of a recording: {words}")
        return observation

    def now_s(self) -> float:
        """Return its time on the run's clock."""
        return self._read(self._part("observation"), _When).now_s

    def has_frame(self) -> bool:
        """Check whether a frame was new in it."""
        return bytes(self._read(self._part("observation"), _When).frame) != b"null"

    def decision(self) -> Decision:
        """Return the decision of the cycle."""
        return self._read(self._part("decision"), Decision)

    def record(self) -> CycleRecord:
        """Return the whole cycle."""
        return self._read(self._line, CycleRecord)

    def _part(self, name: str) -> Raw:
        if self._parts is None:
            self._parts = self._read(self._line, _Parts)
        found: Raw = getattr(self._parts, name)
        return found

    def _read(self, text: bytes | Raw, kind: type[_T]) -> _T:
        try:
            return decode(text, kind)
        except ValueError as error:
            raise JournalError(f"{self._place}: not a cycle of a recording: {error}") from error


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
        self._append(cycle_json(record))

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
            reloaded = None
            for number, line in enumerate(lines, start=2):
                if not line.endswith(b"\n"):
                    return
                place = f"{self.path}:{number}"
                if taken_over := reload_of(line, place):
                    reloaded = taken_over
                    continue
                yield RecordedCycle(line, place, reloaded)
                reloaded = None

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
    if not line:
        raise JournalError(f"{path}: the file is empty")
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
