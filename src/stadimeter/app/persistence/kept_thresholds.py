"""The thresholds that operators have set, read from a state file that no run holds, without changing anything."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

from stadimeter.app.exact_json import decode
from stadimeter.app.persistence.alarm_store import Kind, kind_of, too_large
from stadimeter.core.alarms.settings import keep_thresholds
from stadimeter.core.persistence import AlarmSnapshot
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.words import figure_in_words


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
