"""The plain view: a run as lines of text, for logs, pipes and screen readers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.formatting import (
    format_best,
    format_distance,
    format_level,
    format_speed,
    format_time,
    format_turn,
    length_unit,
)
from stadimeter.cli.glyphs import ASCII, UNICODE
from stadimeter.cli.snapshot import LookedAt
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Event, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.track import Track

SILENT = frozenset({RuleStatus.IDLE, RuleStatus.UNKNOWN})
"""Rules that do nothing are not named in each line."""


class PlainView:
    """Writes a line about the run every second, and each event at once.

    Args:
        write: Takes one line without its line break, such as `print`.
        trouble: Says what is wrong outside the loop; said again only when it changes.
        ascii_only: Whether `write` takes nothing but ASCII.

    Raises:
        ConfigError: Distances are not shown in that unit.
    """

    def __init__(
        self,
        write: Callable[[str], None],
        every_s: float = 1.0,
        *,
        unit: str = "m",
        trouble: Callable[[], str] = str,
        ascii_only: bool = False,
    ) -> None:
        self._write = write
        self._every_s = every_s
        self._unit = length_unit(unit)
        self._trouble = trouble
        self._glyphs = ASCII if ascii_only else UNICODE
        self._started_s: float | None = None
        self._due_s = 0.0
        self._said = ""
        self._looked_at = LookedAt()

    def update(self, record: CycleRecord) -> None:
        """Write what there is to say about a cycle."""
        now_s = record.observation.now_s
        self._looked_at.add(record)
        if self._started_s is None:
            self._started_s = self._due_s = now_s
        for event in record.decision.events:
            self._line(event.at_s, _event_words(event))
        self._say_trouble(now_s)
        if now_s < self._due_s - 1e-9:
            return
        self._line(now_s, "  ".join(self._words(record)))
        missed = int((now_s - self._due_s) / self._every_s + 1e-9) if self._every_s > 0 else 0
        self._due_s += (missed + 1) * self._every_s

    def _say_trouble(self, now_s: float) -> None:
        trouble = self._trouble()
        if trouble != self._said:
            self._line(now_s, trouble or "that trouble is over")
        self._said = trouble

    def _line(self, at_s: float, words: str) -> None:
        self._write(self._glyphs.words(f"{format_time(at_s - (self._started_s or 0.0)):>8}  {words}"))

    def _words(self, record: CycleRecord) -> Iterator[str]:
        decision, observation = record.decision, record.observation
        if decision.safety is not SafetyMode.ACTIVE:
            yield f"{decision.safety.value.upper()}: {decision.safety_reason}"
            if observation.camera_fault:
                yield f"camera: {observation.camera_fault}"
        yield from (self._target(track) for track in decision.tracks)
        yield from (self._output(command) for command in record.applied)
        yield from (f"{fault.output} OUT OF ORDER: {fault.reason}" for fault in observation.output_faults)
        shown = (trace for trace in decision.rules if trace.status not in SILENT)
        yield from (_rule(trace, decision.reasons.get(trace.rule, "")) for trace in shown)

    def _target(self, track: Track) -> str:
        if track.is_valid:
            distance = format_distance(track.distance_m, track.sigma_m, self._unit)
            return f"{track.target} {distance} {track.status.value}"
        best = format_best(track.reason, self._looked_at.by_target.get(track.target, ()))
        why = "; ".join(words for words in (track.reason, best) if words)
        return f"{track.target} {track.status.value}" + (f" ({why})" if why else "")

    def _output(self, command: Command) -> str:
        if isinstance(command, LevelCommand):
            return f"{command.output} {format_level(command.level)}"
        speed = format_speed(command.linear_mps, None, self._unit)
        return f"{command.output} {speed} {format_turn(command.angular_radps)}"


def _rule(trace: RuleTrace, reason: str) -> str:
    marks = ", ".join([*([] if trace.acknowledged else ["unacknowledged"]), *trace.gates])
    return f"{trace.status.value.upper()} {trace.rule}{f' ({marks})' if marks else ''}: {reason}"


def _event_words(event: Event) -> str:
    what = f"* {event.severity.value}: {event.source} {event.kind.value.replace('_', ' ')}"
    return f"{what}: {event.reason}" if event.reason else what
