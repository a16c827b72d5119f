"""The journal: what was known, decided and done in each cycle, one line of JSON a cycle; and a cycle as JSON.

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
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from msgspec import Raw, Struct, field
from msgspec.json import schema
from msgspec.structs import replace
from pydantic_core import from_json

import stadimeter
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.recordings.record_file import RecordFile
from stadimeter.config.addresses import words_for_people
from stadimeter.config.files import (
    CAMERA_FILE_MAX_BYTES,
    lines_of,
    open_untrusted,
    read_untrusted_text,
    sha256_of,
)
from stadimeter.config.findings import format_value
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import path_from
from stadimeter.core.bounds import MAX_TIME_S, is_time
from stadimeter.core.decision import Decision, Event, RuleTrace
from stadimeter.core.frame import Frame
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError, JournalError, Problem, UnreadableError

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


# Stands for the rules of a decision that are those of the cycle before, which are last in it.
AS_BEFORE = b'"as before"'
_RULES_ARE = b',"rules":'

# What older recordings call the inhibits of a rule. No text holds these bytes: in one, quotes are escaped.
_GATES, _INHIBITS = b',"gates":[', b',"inhibits":['


class _RecordedReload(Struct, frozen=True):
    """A configuration that was reloaded while running, and when on the run's monotonic clock."""

    at_s: float
    configuration: RecordedConfiguration


class _Reloaded(Struct, frozen=True):
    reloaded: _RecordedReload


# The parts of a cycle before its decision, in their order, and those of a decision before its rules.
_PARTS = ("observation", "applied", "timings_s")
_DECIDED = tuple(name for name in Decision.__struct_fields__ if name not in {"rules", "reasons"})

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


def cycle_schema() -> dict[str, Any]:
    """Return the JSON Schema of a cycle as `CycleEncoder` writes it."""
    written = schema(CycleRecord, schema_hook=lambda _kind: {"type": "array"})  # points in no journal
    for name, left_out in (("CycleRecord", ("rejected", "detections")), ("Decision", ("reasons",))):
        for key in left_out:
            del written["$defs"][name]["properties"][key]
    return written


class CycleEncoder:
    """Writes the cycles of one run.

    Args:
        repeats_rules: Whether rules that are those of the cycle before are written again. With many rules they would
            be most of each cycle; but only then each cycle can be read on its own.
    """

    def __init__(self, *, repeats_rules: bool) -> None:
        self._repeats_rules = repeats_rules
        self._rules: tuple[RuleTrace, ...] | None = None
        self._rules_json = b"[]"
        self._each: dict[int, tuple[RuleTrace, bytes]] = {}

    def encode(self, record: CycleRecord) -> bytes:
        """Write a cycle."""
        parts = encode({name: getattr(record, name) for name in _PARTS})
        return parts[: -len(b"}")] + b',"decision":' + self.encode_decision(record.decision) + b"}"

    def encode_decision(self, decision: Decision) -> bytes:
        """Write a decision; what rules did, and did in the cycle before, is not made again."""
        rules = AS_BEFORE
        if decision.rules is not self._rules or self._repeats_rules:
            rules = self._encode_rules(decision.rules)
        decided = encode({name: getattr(decision, name) for name in _DECIDED})
        return decided[: -len(b"}")] + _RULES_ARE + rules + b"}"

    def _encode_rules(self, rules: tuple[RuleTrace, ...]) -> bytes:
        if rules is not self._rules:
            # Of a hundred rules a few change at a time, and those that did not are the same objects: an identity
            # stands for one object while that object is held, which the table does until the next change.
            before, self._each = self._each, {}
            for rule in rules:
                known = before.get(id(rule))
                self._each[id(rule)] = known if known is not None else (rule, encode(rule))
            self._rules, self._rules_json = rules, b"[" + b",".join([json for _, json in self._each.values()]) + b"]"
        return self._rules_json


class _When(Struct, frozen=True):
    """The parts of an observation that tell when it was."""

    now_s: float
    frame: Raw


class _Decided(Struct, frozen=True):
    events: tuple[Event, ...]
    rules: Raw


class _Parts(Struct, frozen=True):
    observation: Raw
    decision: Raw


class RecordedCycle:
    """One cycle of a recording, read as far as it is asked for. A part that is damaged raises `JournalError`.

    Args:
        before: The cycle before, for one whose rules are those of that.

    Attributes:
        reloaded: The configuration that was reloaded right before it.
    """

    __slots__ = ("_line", "_parts", "_place", "_rules", "reloaded")

    def __init__(
        self,
        line: bytes,
        place: str,
        reloaded: RecordedConfiguration | None = None,
        before: RecordedCycle | None = None,
    ) -> None:
        self.reloaded = reloaded
        self._place = place
        self._parts: _Parts | None = None
        self._rules: bytes | None = None
        if AS_BEFORE in line:
            self._rules = before.rules_json() if before else b"[]"
            self._line = line.replace(_RULES_ARE + AS_BEFORE, _RULES_ARE + self._rules)
        else:
            self._line = line.replace(_GATES, _INHIBITS)

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

    def events(self) -> tuple[Event, ...]:
        """Return the recorded events."""
        return self._read(self._part("decision"), _Decided).events

    def rules_json(self) -> bytes:
        """Return the JSON of its rules."""
        if self._rules is None:
            self._rules = bytes(self._read(self._part("decision"), _Decided).rules)
        return self._rules

    def decision_json(self) -> bytes:
        """Return the JSON of the decision."""
        return bytes(self._part("decision"))

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
            reloaded = cycle = None
            for number, line in enumerate(lines, start=2):
                if not line.endswith(b"\n"):
                    return
                place = f"{self.path}:{number}"
                if taken_over := reload_of(line, place):
                    reloaded = taken_over
                    continue
                cycle, reloaded = RecordedCycle(line, place, reloaded, before=cycle), None
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
