"""What a run has beside its cycles, in a whole run."""

from datetime import UTC, datetime
from functools import partial

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.clock import TimeOfDay
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.persistence.alarm_store import AlarmStore
from stadimeter.app.persistence.resumption import moment
from stadimeter.app.persistence.state_writer import StateWriter
from stadimeter.config.loader import load_configuration
from support.simulated_run import SIMULATED_BALL

NEAR = """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
"""
AT_NIGHT = """
[rules.at-night]
when = { all = [{ below = "3 m" }, { time = { between = ["22:00", "06:00"] } }] }
on_delay = "0 s"
"""
WORLD = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""


def loop_of(folder, *rules):
    path = folder / "run.toml"
    path.write_text("".join((SIMULATED_BALL, *rules, WORLD)))
    return Loop(build(load_configuration(path), speed=None))


def events_of(loop, **limits):
    events, observations = [], []
    loop.listeners.append(lambda record, _frame: events.extend(record.decision.events))
    loop.listeners.append(lambda record, _frame: observations.append(record.observation))
    loop.run(Limits(**limits))
    return [(event.source, event.kind.value) for event in events if event.source != "ball"], observations


def remembering(loop, path):
    loop.services.memory = StateWriter(AlarmStore(path), partial(moment, "stepped"))
    return loop


def test_an_alarm_goes_on_in_the_next_run(tmp_path):
    path = tmp_path / "run.sqlite3"
    first, _ = events_of(remembering(loop_of(tmp_path, NEAR), path), seconds=1)
    second, _ = events_of(remembering(loop_of(tmp_path, NEAR), path), seconds=1)
    assert first == [("near", "raised")]
    assert second == []


def clock(hour, *, is_right=True):
    now = datetime(2026, 11, 21, hour, 0, tzinfo=UTC)
    return TimeOfDay(is_live=False, now=lambda: now, is_right=lambda: is_right)


@pytest.mark.parametrize(
    ("of_day", "expected"),
    [(clock(23), [("at-night", "raised")]), (clock(12), []), (clock(23, is_right=False), []), (None, [])],
)
def test_a_rule_that_goes_by_the_time_of_day_is_told_it_if_it_is_known(tmp_path, of_day, expected):
    loop = loop_of(tmp_path, AT_NIGHT)
    loop.services.time_of_day = of_day
    assert events_of(loop, seconds=1)[0] == expected


def test_a_run_without_such_a_rule_never_looks_at_the_clock(tmp_path):
    loop = loop_of(tmp_path, NEAR)
    loop.services.time_of_day = clock(23)
    _, observations = events_of(loop, seconds=1)
    assert {observation.wall for observation in observations} == {None}


def test_what_was_taken_over_is_recorded_so_that_a_replay_begins_with_it_too(tmp_path):
    from typer.testing import CliRunner

    from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
    from stadimeter.app.recordings.recorder import Recorder
    from stadimeter.cli.main import app

    path, journal = tmp_path / "run.sqlite3", tmp_path / "run.jsonl"
    events_of(remembering(loop_of(tmp_path, NEAR), path), seconds=1)
    loop = remembering(loop_of(tmp_path, NEAR), path)
    recorder = Recorder(JournalWriter(journal, to_be_recorded(loop.parts.configuration)), is_live=False)
    loop.listeners.append(recorder)
    assert events_of(loop, seconds=1)[0] == []
    recorder.close()
    done = CliRunner().invoke(app, ["replay", str(journal), "--strict"])
    assert done.exit_code == 0, done.output
    assert "30 cycles, 30 decisions identical" in done.output
