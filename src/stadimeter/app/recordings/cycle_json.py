"""One cycle as JSON, as journals and recordings hold it.

A recording of an hour has a hundred thousand cycles, so they are read no further than is asked for: deciding again
takes the observation only, and a decision that is the recorded one is known by its bytes. For that the parts of a cycle
are always written in the order observation, applied, timings, decision, and the rules come last in the decision.

Numbers are written so that reading them gives the same bits again. What is no number, such as NaN, is written as text.
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct
from msgspec.json import schema

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.core.bounds import MAX_TIME_S, is_time
from stadimeter.core.decision import Decision, Event, RuleTrace
from stadimeter.core.observation import Observation
from stadimeter.errors import JournalError

# Stands for the rules of a decision that are those of the cycle before.
AS_BEFORE = b'"as before"'

# The frame comes second in an observation, after one number.
_NO_EVENTS = b'"events":[],'
_NO_FRAME = b'"frame":null,'
_FRAME_BEFORE = 80

_OPENING = b'{"observation":'
_TIME_BEGINS = len(_OPENING + b'{"now_s":')
_APPLIED = b',"applied":'
_DECISION = b',"decision":'
_RULES_KEY = b',"rules":'

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
        is_as_before = record.decision.rules is self._rules
        rules = AS_BEFORE if is_as_before and not self._repeats_rules else self.rules_json(record.decision.rules)
        parts = encode({name: getattr(record, name) for name in _PARTS})
        return parts[: -len(b"}")] + _DECISION + self.decision_json(record.decision) + _RULES_KEY + rules + b"}}"

    def decision_json(self, decision: Decision) -> bytes:
        """Write a decision without its rules, and without the brace that closes it."""
        return encode({name: getattr(decision, name) for name in _DECIDED})[: -len(b"}")]

    def rules_json(self, rules: tuple[RuleTrace, ...]) -> bytes:
        """Write what rules did; what did not change since the last time is not made again."""
        if rules is not self._rules:
            # Of a hundred rules a few change at a time, and those that did not are the same objects: an identity
            # stands for one object while that object is held, which the table does until the next change.
            before, self._each = self._each, {}
            for rule in rules:
                known = before.get(id(rule))
                self._each[id(rule)] = known if known is not None else (rule, encode(rule))
            self._rules, self._rules_json = rules, b"[" + b",".join([json for _, json in self._each.values()]) + b"]"
        return self._rules_json


class RecordedCycle:
    """One cycle of a recording, read as far as it is asked for.

    Attributes:
        rules_json: The JSON of its rules.
        reloaded: The configuration that was reloaded right before it.
    """

    __slots__ = ("_line", "_place", "reloaded", "rules_json")

    def __init__(
        self, line: bytes, rules_before: bytes, place: str, reloaded: RecordedConfiguration | None = None
    ) -> None:
        self.reloaded = reloaded
        self._line = line.rstrip()
        self._place = place
        rules = self._line[self._line.rfind(_RULES_KEY) + len(_RULES_KEY) : -len(b"}}")]
        self.rules_json = rules_before if rules == AS_BEFORE else rules.replace(_GATES, _INHIBITS)

    def observation(self) -> Observation:
        """Return the observation of the cycle. Like every part, it raises `JournalError` if the cycle is damaged."""
        try:
            observation = decode(self._line[len(_OPENING) : self._line.find(_APPLIED)], Observation)
        except ValueError:
            observation = self.record().observation  # which names what is wrong, or knows another order of the parts
        captured_s = [measured.captured_at_s for measured in observation.measurements]
        if observation.frame is not None:
            captured_s.append(observation.frame.captured_at_s)
        if not is_time(observation.now_s, *captured_s):
            words = f"a time beyond {MAX_TIME_S:g} s, which no clock shows"
            raise JournalError(f"{self._place}: not a cycle of a recording: {words}")
        return observation

    def now_s(self) -> float:
        """Return its time on the run's clock, which comes first in it."""
        try:
            return float(self._line[_TIME_BEGINS : self._line.find(b",", _TIME_BEGINS)])
        except ValueError:
            return self.observation().now_s

    def has_frame(self) -> bool:
        """Check whether a frame was new in it."""
        return self._line.find(_NO_FRAME, 0, _FRAME_BEFORE) < 0

    def events(self) -> tuple[Event, ...]:
        """Return the recorded events."""
        return () if _NO_EVENTS in self._line else self.record().decision.events

    def decision_json(self) -> bytes:
        """Return the JSON of the decision without its rules and without the brace that closes it."""
        begin = self._line.find(_DECISION) + len(_DECISION)
        return self._line[begin : self._line.rfind(_RULES_KEY)]

    def record(self) -> CycleRecord:
        """Return the whole cycle."""
        head, key, _ = self._line.rpartition(_RULES_KEY)
        whole = head + key + self.rules_json + b"}}" if key else self._line
        try:
            return decode(whole, CycleRecord)
        except ValueError as error:
            raise JournalError(f"{self._place}: not a cycle of a recording: {error}") from error
