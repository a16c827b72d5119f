"""Alarm states, undelivered messages and the stop of the outputs, in a file that survives a power cut: SQLite.

The file is written with a write-ahead log: each change is one append and one flush, and after a power cut it holds what
was before the change or what was after it. The append outlives the program at once; the flush, which outlives a power
cut, takes a memory card up to half a second, so it is a call of its own (``synchronous=NORMAL``). A rollback journal
would flush three times and rewrite pages in place, which wears out a memory card sooner. The lock is exclusive: two
runs on one file would take turns in forgetting what the other remembers.

All of it is one table of keys and values as JSON. Bytes that a failing card has flipped are noticed by SQLite's own
check and by a checksum over all rows. What is damaged, or of a later version, is put aside under another name, for
inspection.

SQLite writes to what it opens, and makes files beside it. So the first bytes are read here, and a file that is not ours
is never opened. The libraries that read a damaged file raise whatever they like: an error of SQLite, text that is not
UTF-8, a value of another type. So whatever is raised while reading means the same.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

from stadimeter.app.deliveries import Undelivered
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.persistence.resumption import ClockReading, Memory
from stadimeter.config.files import open_untrusted, rename_to_free_name
from stadimeter.core.alarms.machine import keep_thresholds
from stadimeter.core.message import Message, Notification
from stadimeter.core.persistence import Absence, AlarmSnapshot
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.words import figure_in_words
from stadimeter.errors import StateError, UnreadableError

# Says whose file it is: ``Stad``.
APPLICATION_ID = 0x53746164

# What SQLite keeps beside a file.
BESIDE = ("-wal", "-shm", "-journal")

# Where a SQLite file has its application id; see https://www.sqlite.org/fileformat.html#the_database_header.
_HEADER_BYTES = 100
_MAGIC = b"SQLite format 3\0"
_ID_AT = 68

FORMAT = 6

# As SQLite keeps it, to the letter.
_TABLE = "CREATE TABLE memory (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID"

# The keys: of one row each, and the beginnings of those of several.
_MOMENT, _ABSENT, _STOPPED, _CHECKSUM = "moment", "absent", "stopped", "checksum"
_ALARM, _UNDELIVERED = "alarm ", "undelivered "

# Pages of 4 KiB after which SQLite moves the log into the file, and the most that it has: a full file has ten MiB.
LOG_PAGES_MAX = 64
PAGES_MAX = 8192

_ITEM: Any = tuple[str, Message | Notification]  # mypy takes a union for no type

# What SQLite says when nothing is wrong with the file, but with the disk or with us.
_UNWRITABLE = frozenset(
    {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_FULL, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR}
)

# Undelivered messages by their number.
Queue = Mapping[int, Undelivered]


def is_ours(path: Path) -> bool | None:
    """Check whether a file is a state file, whole or not; None if there is none, or an empty one.

    Raises `StateError` if it is a folder, a pipe or a device, or cannot be looked at: a name too long, a loop of links.
    """
    try:
        with open_untrusted(path) as file:
            header = file.read(_HEADER_BYTES)
    except UnreadableError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise StateError(f"{path} cannot be used: {error.reason}") from error
    if not header:
        return None
    return header.startswith(_MAGIC) and header[_ID_AT : _ID_AT + 4] == APPLICATION_ID.to_bytes(4, "big")


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


class _UnusableError(Exception):
    """The file is not as it was written, or was by a later version of the program."""

    def __init__(self, words: str, ending: str = "damaged") -> None:
        super().__init__(f"is damaged: {words}" if ending == "damaged" else words)
        self.ending = ending


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
        self._rows: dict[str, str] = {}
        self._queued: dict[int, Undelivered] = {}
        self._checksum = 0

    def check(self) -> None:
        """See, without changing anything, that the file is ours or not there yet; else raise `StateError`."""
        if is_ours(self.path) is False and self._is_named:
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
        except _UnusableError as error:
            aside = put_aside(self.path, error.ending)
            self.warning = f"{self.path} {error}; it is now {aside}, and the alarms start anew"
        try:
            return self._opened()
        except _UnusableError as error:
            raise StateError(f"{self.path} {error}") from error

    def write(self, memory: Memory) -> None:
        """Write what alarms remember now, all of it or nothing; alarms in the file and not here are forgotten.

        Raises `StateError` if it could not be written, for a full disk for example.
        """
        rows = {
            _MOMENT: encode(memory.moment).decode(),
            _ABSENT: encode(memory.absent).decode(),
            **({_STOPPED: memory.stopped} if memory.stopped else {}),
            **{_ALARM + alarm.rule: encode(alarm).decode() for alarm in memory.alarms},
        }
        queued = moved_on(self._queued, memory.undelivered)
        new = dict(row for row in rows.items() if self._rows.get(row[0]) != row[1])
        new |= dict(_queue_row(*each) for each in queued.items() if each[0] not in self._queued)
        gone = {key: value for key, value in self._rows.items() if key in new or key not in rows}
        gone |= dict(_queue_row(*each) for each in self._queued.items() if each[0] not in queued)
        checksum = self._checksum + _sum_of(new) - _sum_of(gone)
        with self._transaction() as database:
            database.executemany("DELETE FROM memory WHERE key = ?", [(key,) for key in gone if key not in new])
            written = [*new.items(), (_CHECKSUM, f"{checksum:x}")]
            database.executemany("INSERT OR REPLACE INTO memory VALUES (?, ?)", written)
        self._rows, self._queued, self._checksum = rows, queued, checksum

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
        if is_ours(self.path) is False:  # SQLite sees no file before this has
            raise _UnusableError("it is no state file")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with suppress(FileExistsError):  # SQLite would let everybody read a new file, and what it keeps beside it
                os.close(os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
            self._database = sqlite3.connect(
                self.path, timeout=0.5, isolation_level=None, check_same_thread=False, cached_statements=16
            )
            return self._read(self._database)
        except Exception as error:
            self.close()
            raise self._converted(error) from error

    def _converted(self, error: Exception) -> Exception:
        """Tell a file that cannot be used as it is from one that cannot be used at all."""
        if isinstance(error, _UnusableError | StateError):
            return error
        if isinstance(error, OSError):
            return StateError(f"{self.path} cannot be written: {error.strerror or error}")
        if not isinstance(error, sqlite3.Error):
            return _UnusableError(f"{type(error).__name__}: {error}")
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            return StateError(f"{self.path} is used by another run; this one remembers nothing after its end")
        may_be_written = all(os.access(each, os.W_OK) for each in (self.path, self.path.parent))
        if code in _UNWRITABLE and not (
            code == sqlite3.SQLITE_READONLY and may_be_written
        ):  # a byte in it may forbid it
            return StateError(f"{self.path} cannot be written: {error}")
        return _UnusableError(str(error))

    def _read(self, database: sqlite3.Connection) -> Memory | None:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        if not _pragma(database, "page_count"):  # new, or cut while it was begun, which SQLite has just undone
            # Before there is a log: else the file would not be known as ours until the log is taken over into it.
            database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")  # the rest is `flush`
        database.execute(f"PRAGMA wal_autocheckpoint = {LOG_PAGES_MAX}")
        database.execute(f"PRAGMA max_page_count = {PAGES_MAX}")
        database.execute("BEGIN EXCLUSIVE")  # takes the lock, and keeps it
        version, application = _pragma(database, "user_version"), _pragma(database, "application_id")
        if application != APPLICATION_ID:
            raise _UnusableError("it is no state file")
        if version not in {0, FORMAT}:
            which, ending = ("a later", "newer") if version > FORMAT else ("an earlier", "older")
            words = f"was written by {which} version of stadimeter (format {version}, not {FORMAT})"
            raise _UnusableError(words, ending)
        found = [sql for (sql,) in database.execute("SELECT sql FROM sqlite_schema")]
        if not found:
            database.execute(_TABLE)
            database.execute(f"PRAGMA user_version = {FORMAT}")
        elif found != [_TABLE]:  # a flipped letter may change what a column takes, or how long a query runs
            raise _UnusableError("its table is not that of a state file")
        database.execute("DELETE FROM memory WHERE key = ''")  # changes nothing, and fails if nothing can be changed
        memory = self._checked(database)
        database.execute("COMMIT")
        return memory

    def _checked(self, database: sqlite3.Connection) -> Memory | None:
        (verdict,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            raise _UnusableError(verdict)
        rows: dict[str, str] = dict(database.execute("SELECT key, value FROM memory").fetchall())
        if not rows:
            return None
        checksum = _sum_of({key: value for key, value in rows.items() if key != _CHECKSUM})
        if rows.get(_CHECKSUM) != f"{checksum:x}":
            raise _UnusableError("its checksum is wrong")
        try:
            alarms = [decode(rows[key], AlarmSnapshot) for key in sorted(rows) if key.startswith(_ALARM)]
            waiting = [key for key in sorted(rows) if key.startswith(_UNDELIVERED)]
            queued = {int(key.removeprefix(_UNDELIVERED)): decode(rows[key], _ITEM) for key in waiting}
            memory = Memory(
                moment=decode(rows[_MOMENT], ClockReading),
                alarms=tuple(alarms),
                absent=decode(rows[_ABSENT], tuple[Absence, ...]),
                undelivered=tuple(queued.values()),
                stopped=rows.get(_STOPPED, ""),
            )
        except (ValueError, KeyError) as error:
            raise _UnusableError(f"it holds something else than alarms: {error}") from error
        self._rows = {key: rows[key] for key in rows if key != _CHECKSUM and not key.startswith(_UNDELIVERED)}
        self._queued, self._checksum = queued, checksum
        return memory


def _pragma(database: sqlite3.Connection, name: str) -> int:
    (value,) = database.execute(f"PRAGMA {name}").fetchone()
    return int(value)


def moved_on(rows: Queue, queued: Iterable[Undelivered]) -> dict[int, Undelivered]:
    """Return the rows as they shall be: queues lose in any place, and grow at their ends only."""
    queues: dict[str, deque[Undelivered]] = {}
    for each in queued:
        queues.setdefault(each[0], deque()).append(each)
    stay = {}
    for number, row in rows.items():
        if (queue := queues.get(row[0])) and queue[0] == row:
            stay[number] = queue.popleft()
    new = (each for queue in queues.values() for each in queue)
    return stay | dict(enumerate(new, start=max(rows, default=0) + 1))


def _queue_row(number: int, item: Undelivered) -> tuple[str, str]:
    """Return the row of an undelivered message; those that come one after another stand side by side."""
    return f"{_UNDELIVERED}{number:09}", encode(item).decode()


def _sum_of(rows: Mapping[str, str]) -> int:
    """Return a checksum over rows. Theirs are added up, so that it follows those that come and go."""
    return sum(int.from_bytes(hashlib.sha256(json.dumps(row).encode()).digest(), "big") for row in rows.items())


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
        if not is_ours(file) or file.with_name(f"{file.name}-wal").exists():
            return ()
        # Immutable: SQLite takes no lock, and makes no file beside it.
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
            rows = database.execute("SELECT key, value FROM memory ORDER BY key").fetchall()
            return tuple(decode(value, AlarmSnapshot) for key, value in rows if key.startswith(_ALARM))
    except Exception:  # noqa: BLE001 - whatever is wrong with the file, the next run says it
        return ()
