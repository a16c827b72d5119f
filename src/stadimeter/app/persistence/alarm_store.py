"""Alarm states, undelivered messages and the stop of the outputs, in a file that survives a power cut: SQLite.

The file is written with a write-ahead log: each change is one append and one flush, and after a power cut it holds what
was before the change or what was after it. The append outlives the program at once; the flush, which outlives a power
cut, takes a memory card up to half a second, so it is a call of its own (``synchronous=NORMAL``). A rollback journal
would flush three times and rewrite pages in place, which wears out a memory card sooner. The lock is exclusive: two
runs on one file would take turns in forgetting what the other remembers.

Bytes that a failing card has flipped are noticed by SQLite's own check and by a checksum over everything that is
remembered. What is damaged, or of a later version, is put aside under another name, for inspection.

SQLite writes to what it opens, and makes files beside it. So the first bytes are read here, and a file that is not ours
is never opened. Reading them blocks on nothing, whatever has the name: a folder, a pipe or a device is no state file.
The bytes of a file may come from anywhere, and the libraries that read them raise whatever they like: an error of
SQLite, text that is not UTF-8, a value of another type, no memory. So whatever is raised while reading means the same,
and the file's size and the length of a value are bounded.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import stat
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from enum import Enum, auto
from itertools import count
from pathlib import Path
from typing import Any

from stadimeter.app.deliveries import Undelivered
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.persistence.resumption import ClockReading, Memory
from stadimeter.config.files import rename_to_free_name
from stadimeter.core.alarms.machine import keep_thresholds
from stadimeter.core.message import Message, Notification
from stadimeter.core.persistence import Absence, AlarmSnapshot
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.words import figure_in_words
from stadimeter.errors import StateError

# Says whose file it is: ``Stad``.
APPLICATION_ID = 0x53746164

# A full state file has about 2 MiB, with the longest texts ten. What is larger we did not write, and do not read.
SIZE_MAX = 32 * 2**20

# What SQLite keeps beside a file.
BESIDE = ("-wal", "-shm", "-journal")

# Where a SQLite file has its application id; see https://www.sqlite.org/fileformat.html#the_database_header.
_HEADER_BYTES = 100
_MAGIC = b"SQLite format 3\0"
_ID_AT = 68

# So many bytes of those by which we know our own may be wrong: a memory card that flips one makes it no stranger's.
_FLIPPED_MAX = 1


class Kind(Enum):
    """The kind of thing that has the name of a state file."""

    NOTHING = auto()
    """No file, or an empty one."""
    OURS = auto()
    """A state file, whole or not."""
    FOREIGN = auto()
    """Something else."""


def kind_of(path: Path) -> Kind:
    """Look at a file, without changing it or waiting for it.

    Raises `StateError` if it is a folder, a pipe or a device, or cannot be looked at: a name too long, a loop of links.
    """
    try:
        header = _header(path)
    except FileNotFoundError:
        return Kind.NOTHING
    except (OSError, ValueError) as error:
        raise StateError(f"{path} cannot be used: {getattr(error, 'strerror', None) or error}") from error
    if not header:
        return Kind.NOTHING
    known = _MAGIC + APPLICATION_ID.to_bytes(4, "big")
    found = header[: len(_MAGIC)] + header[_ID_AT : _ID_AT + 4]
    wrong = sum(here != there for here, there in zip(found, known, strict=False)) + len(known) - len(found)
    return Kind.OURS if wrong <= _FLIPPED_MAX else Kind.FOREIGN


def _header(path: Path) -> bytes:
    if not stat.S_ISREG(path.stat().st_mode):  # before it is opened: that alone resets some devices
        raise ValueError("it is no regular file")
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return os.read(file, _HEADER_BYTES) if stat.S_ISREG(os.fstat(file).st_mode) else b""
    finally:
        os.close(file)


def too_large(path: Path) -> bool:
    """Check whether a state file, or its log, has more bytes than we ever write."""
    for file in (path, *(path.with_name(path.name + ending) for ending in BESIDE)):
        with suppress(FileNotFoundError):  # SQLite removes its log when another process closes the file
            if file.stat().st_size > SIZE_MAX:
                return True
    return False


def put_aside(path: Path, why: str) -> Path:
    """Rename a state file, and what SQLite keeps beside it, such as to ``run.sqlite3.damaged-1``; return that name.

    Raises `StateError` if the folder is read-only, for example.
    """
    try:
        aside = rename_to_free_name(path, (f"{path.name}.{why}-{number}" for number in count(1)))
        for ending in BESIDE:
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).rename(aside.with_name(aside.name + ending))
    except OSError as error:
        raise StateError(f"{path} cannot be put aside: {error.strerror or error}") from error
    return aside


FORMAT = 5

# Pages of 4 KiB after which SQLite moves the log into the file.
LOG_PAGES_MAX = 64

# No value in the file is longer.
VALUE_BYTES_MAX = 2 * 2**20

_ITEM: Any = Message | Notification  # mypy takes a union for no type

# What SQLite says when nothing is wrong with the file, but with the disk or with us.
_UNWRITABLE = frozenset(
    {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_FULL, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR}
)

# As SQLite keeps them, to the letter: a flipped one may change what a column takes, or how long a query runs.
_TABLES = (
    "CREATE TABLE alarm (rule TEXT PRIMARY KEY, memory TEXT NOT NULL) WITHOUT ROWID",
    "CREATE TABLE undelivered (number INTEGER PRIMARY KEY, name TEXT NOT NULL, item TEXT NOT NULL)",
    "CREATE TABLE saved (one INTEGER PRIMARY KEY, moment TEXT NOT NULL, absent TEXT NOT NULL, sha256 TEXT NOT NULL)",
    "CREATE TABLE stopped (one INTEGER PRIMARY KEY, said TEXT NOT NULL)",
)


# Undelivered messages by the number of their row.
Queue = Mapping[int, Undelivered]


class _DamagedError(Exception):
    """The file is not as it was written."""


class _LaterVersionError(Exception):
    """A later version of the program has written the file."""


class AlarmStore:
    """The file. It may be used from any thread, by one at a time.

    Attributes:
        warning: What was wrong with the file that was found, and what became of it; empty for nothing.
    """

    def __init__(self, path: Path, *, is_named: bool = False) -> None:
        self.path = path
        self.warning = ""
        self._is_named = is_named
        self._database: sqlite3.Connection | None = None
        self._written: dict[str, str] = {}
        self._queued: dict[int, Undelivered] = {}
        self._sums: dict[int, int] = {}

    def check(self) -> None:
        """See, without changing anything, that the file is ours or not there yet; else raise `StateError`."""
        if kind_of(self.path) is Kind.FOREIGN and self._is_named:
            raise StateError(f"{self.path} is no state file, and was left as it is; name another file with --state")

    def open(self) -> Memory | None:
        """Open the file and read it. One that cannot be used is put aside, and an empty one is begun.

        Returns:
            What was remembered; None if nothing was.

        Raises:
            StateError: The file is not ours, cannot be written, or another run uses it.
        """
        self.check()
        try:
            return self._opened()
        except _LaterVersionError as error:
            aside = put_aside(self.path, "newer")
            self.warning = f"{self.path}: {error}; it is now {aside}, and this run remembers nothing of earlier ones"
        except _DamagedError as error:
            aside = put_aside(self.path, "damaged")
            self.warning = f"{self.path} is damaged: {error}; it is now {aside}, and the alarms start anew"
        try:
            return self._opened()
        except (_DamagedError, _LaterVersionError) as error:
            raise StateError(f"{self.path}: {error}") from error

    def write(self, memory: Memory) -> None:
        """Write what alarms remember now, all of it or nothing; alarms in the file and not here are forgotten.

        Raises `StateError` if it could not be written, for a full disk for example.
        """
        memories = {alarm.rule: encode(alarm).decode() for alarm in memory.alarms}
        rest = encode(memory.moment).decode(), encode(memory.absent).decode()
        stopped = (memory.stopped,) if memory.stopped else ()
        queued, delivered = moved_on(self._queued, memory.undelivered)
        new = [(key, name, encode(item).decode()) for key, (name, item) in queued.items() if key not in self._sums]
        sums = {key: self._sums[key] for key in queued if key in self._sums} | {row[0]: _row_sum(row) for row in new}
        changed = [(rule, memory) for rule, memory in memories.items() if self._written.get(rule) != memory]
        gone = [(rule,) for rule in self._written if rule not in memories]
        with self._transaction() as database:
            database.executemany("INSERT OR REPLACE INTO alarm VALUES (?, ?)", changed)
            database.executemany("DELETE FROM alarm WHERE rule = ?", gone)
            database.executemany("DELETE FROM undelivered WHERE number = ?", delivered)
            database.executemany("INSERT INTO undelivered VALUES (?, ?, ?)", new)
            database.execute("DELETE FROM stopped")
            database.executemany("INSERT INTO stopped VALUES (1, ?)", [stopped] if stopped else [])
            saved = (*rest, _sha256((*rest, *stopped), memories.items(), sums.values()))
            database.execute("INSERT OR REPLACE INTO saved VALUES (1, ?, ?, ?)", saved)
        self._written, self._queued, self._sums = memories, queued, sums

    def flush(self) -> None:
        """Have the disk take what was written, else raise `StateError`. In any thread, also during a write."""
        try:
            log = os.open(f"{self.path}-wal", os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(log)
            finally:
                os.close(log)
        except FileNotFoundError:  # it was taken over into the file, and flushed with it
            pass
        except OSError as error:
            raise StateError(f"{self.path} cannot be written: {error.strerror or error}") from error

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        if self._database is not None:
            with suppress(sqlite3.Error):  # a full disk; what was written is in the log beside the file
                self._database.close()
            self._database = None

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        if self._database is None:
            raise StateError(f"{self.path} is not open")
        try:
            with self._database as database:
                database.execute("BEGIN IMMEDIATE")
                yield database
        except sqlite3.Error as error:
            raise StateError(f"{self.path} cannot be written: {error}") from error

    def _opened(self) -> Memory | None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._look()
            with suppress(FileExistsError):  # SQLite would let everybody read a new file, and what it keeps beside it
                os.close(os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
            self._database = _connected(self.path)
            return self._read(self._database)
        except Exception as error:
            self.close()
            raise self._converted(error) from error

    def _look(self) -> None:
        """See that a file is ours, if there is one. SQLite sees no file before this has."""
        if kind_of(self.path) is Kind.FOREIGN:
            raise _DamagedError("it is no state file")
        if too_large(self.path):
            raise _DamagedError("it is larger than any that was written here")

    def _converted(self, error: Exception) -> Exception:
        """Tell a file that cannot be used as it is from one that cannot be used at all."""
        if isinstance(error, _DamagedError | _LaterVersionError | StateError):
            return error
        if isinstance(error, OSError):
            return StateError(f"{self.path} cannot be written: {error.strerror or error}")
        if not isinstance(error, sqlite3.Error):
            return _DamagedError(f"{type(error).__name__}: {error}")
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            return StateError(f"{self.path} is used by another run; this one remembers nothing after its end")
        if code in _UNWRITABLE and not self._claims_to_be_read_only(code):
            return StateError(f"{self.path} cannot be written: {error}")
        return _DamagedError(str(error))

    def _claims_to_be_read_only(self, code: int) -> bool:
        """Check whether it is a byte in the file that forbids writing, and not the disk."""
        return code == sqlite3.SQLITE_READONLY and all(
            os.access(each, os.W_OK) for each in (self.path, self.path.parent)
        )

    def _read(self, database: sqlite3.Connection) -> Memory | None:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        if not _pragma(database, "page_count"):  # new, or cut while it was begun, which SQLite has just undone
            # Before there is a log: else the file would not be known as ours until the log is taken over into it.
            database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")  # the rest is `flush`
        database.execute(f"PRAGMA wal_autocheckpoint = {LOG_PAGES_MAX}")
        database.execute(f"PRAGMA max_page_count = {SIZE_MAX // _pragma(database, 'page_size')}")
        database.execute("BEGIN EXCLUSIVE")  # takes the lock, and keeps it
        version, application = _pragma(database, "user_version"), _pragma(database, "application_id")
        if version > FORMAT and application == APPLICATION_ID:
            raise _LaterVersionError(f"written by a later version of stadimeter (format {version}, not {FORMAT})")
        if version not in {0, FORMAT} or application != APPLICATION_ID:
            raise _DamagedError("it is no state file")
        _make_tables(database)
        database.execute("DELETE FROM saved WHERE one <> 1")  # changes nothing, and fails if nothing can be changed
        memory = self._checked(database)
        database.execute("COMMIT")
        return memory

    def _checked(self, database: sqlite3.Connection) -> Memory | None:
        (verdict,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            raise _DamagedError(verdict)
        rows = dict(database.execute("SELECT rule, memory FROM alarm ORDER BY rule").fetchall())
        saved = database.execute("SELECT moment, absent, sha256 FROM saved").fetchall()
        queued = database.execute("SELECT number, name, item FROM undelivered ORDER BY number").fetchall()
        stopped = [said for (said,) in database.execute("SELECT said FROM stopped").fetchall()]
        if not (saved or rows or queued or stopped):
            return None
        sums = {row[0]: _row_sum(row) for row in queued}
        if len(saved) != 1 or saved[0][2] != _sha256((*saved[0][:2], *stopped), rows.items(), sums.values()):
            raise _DamagedError("its checksum is wrong")
        try:
            alarms = tuple(decode(memory, AlarmSnapshot) for memory in rows.values())
            queue = {number: (name, decode(item, _ITEM)) for number, name, item in queued}
            moment, absent = decode(saved[0][0], ClockReading), decode(saved[0][1], tuple[Absence, ...])
        except ValueError as error:
            raise _DamagedError(f"it holds something else than alarms: {error}") from error
        self._written, self._queued, self._sums = rows, queue, sums
        undelivered = tuple(queue.values())
        return Memory(moment=moment, alarms=alarms, absent=absent, undelivered=undelivered, stopped="".join(stopped))


def _connected(path: Path) -> sqlite3.Connection:
    """Open a file that may hold anything."""
    database = sqlite3.connect(path, timeout=0.5, isolation_level=None, check_same_thread=False, cached_statements=16)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, VALUE_BYTES_MAX)
    return database


def _make_tables(database: sqlite3.Connection) -> None:
    """Make the tables that a file does not have yet. It must have no others."""
    found = {sql for (sql,) in database.execute("SELECT sql FROM sqlite_schema")}
    if not found <= {*_TABLES}:
        raise _DamagedError("its tables are not those of a state file")
    missing = [table for table in _TABLES if table not in found]
    for table in missing:
        database.execute(table)
    if missing:
        database.execute(f"PRAGMA user_version = {FORMAT}")


def _pragma(database: sqlite3.Connection, name: str) -> int:
    (value,) = database.execute(f"PRAGMA {name}").fetchone()
    return int(value)


def moved_on(rows: Queue, queued: Iterable[Undelivered]) -> tuple[dict[int, Undelivered], list[tuple[int]]]:
    """Return the rows as they shall be, and which ones go: queues lose in any place, and grow at their ends only."""
    queues: dict[str, deque[Undelivered]] = {}
    for each in queued:
        queues.setdefault(each[0], deque()).append(each)
    stay, gone = {}, []
    for number, row in rows.items():
        if (queue := queues.get(row[0])) and queue[0] == row:
            stay[number] = queue.popleft()
        else:
            gone.append((number,))
    new = (each for queue in queues.values() for each in queue)
    return stay | dict(enumerate(new, start=max(rows, default=0) + 1)), gone


def _row_sum(row: Sequence[object]) -> int:
    """Return a checksum over a row; computed once, however often the file is written while the row is in it."""
    return int.from_bytes(hashlib.sha256(json.dumps(row).encode()).digest(), "big")


def _sha256(rest: Sequence[str], memories: Iterable[tuple[str, str]], sums: Iterable[int]) -> str:
    """Return a checksum over everything in the file. The sums of the rows are added up: each has its number in it."""
    return hashlib.sha256(json.dumps([rest, sorted(memories), sum(sums)]).encode()).hexdigest()


def describe_kept(file: Path, rules: Iterable[AnyRule]) -> Iterator[str]:
    """Yield in words which thresholds the next run of these rules begins with; none if the file cannot be read."""
    alarms = {rule.name: rule for rule in rules if isinstance(rule, AlarmRule)}
    for memory in _memories(file):
        if memory.rule in alarms:
            kept, _ = keep_thresholds(alarms[memory.rule], memory.record.thresholds)
            for each in kept:
                value, configured = (figure_in_words(figure, each.unit) for figure in (each.value, each.configured))
                by = each.by or "an operator"
                yield f"`{memory.rule}`: {each.key} is set to {value} by {by}; the configuration says {configured}."


def _memories(file: Path) -> tuple[AlarmSnapshot, ...]:
    """Return the memories of alarms; nothing while a run holds the file, or after it was killed: its log is newer."""
    try:
        if kind_of(file) is not Kind.OURS or too_large(file) or file.with_name(f"{file.name}-wal").exists():
            return ()
        # Immutable: SQLite takes no lock, and makes no file beside it.
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
            rows = database.execute("SELECT memory FROM alarm ORDER BY rule").fetchall()
            return tuple(decode(memory, AlarmSnapshot) for (memory,) in rows)
    except Exception:  # noqa: BLE001 - whatever is wrong with the file, the next run says it
        return ()
