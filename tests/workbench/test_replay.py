"""Replays: read no further than need be, and never wrong for it."""

import json

import pytest
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import ClockReading, Memory, resume, state_text
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration, read_journal
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.persistence import snapshot_alarms
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.replay import decisions
from support.observing import Rehearsal
from support.recordings import records_of
from support.replaying import replay
from support.whole_runs import whole_run


def plan(below_m=1.0):
    alarm = AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=below_m))
    return Plan(targets=("ball",), rules=(alarm,), outputs=(LevelOutput(name="buzzer"),))


def journal_of(path, *sights, rules=None, change=lambda line: line):
    rehearsal = Rehearsal(rules or plan())
    records = []
    rehearsal.cycle = lambda observation: records.append(observation) or Rehearsal.cycle(rehearsal, observation)
    rehearsal.see(*sights)
    writer = JournalWriter(path, RecordedConfiguration(text="# configuration"))
    for observation, (_, decision) in zip(records, rehearsal.decisions, strict=True):
        writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
    writer.close()
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([header, *map(change, lines)]) + "\n")
    return read_journal(path)


SIGHTS = (3, 2, 1, 0.8, 0.8, 0.8, None, 2, 2)


def without_what_is_new(line):
    """Return a cycle as a version wrote it that knew less: without what has a default value."""
    cycle = json.loads(line)
    for name in ("wall", "operator_commands"):
        cycle["observation"].pop(name, None)
    for name in ("notices", "answers"):
        cycle["decision"].pop(name, None)
    for event in cycle["decision"]["events"]:
        for name in ("notify", "first_out", "by"):
            event.pop(name, None)
    return json.dumps(cycle, separators=(",", ":"))


def test_a_journal_of_an_older_version_replays_to_the_same_decisions(tmp_path):
    journal = journal_of(tmp_path / "run.jsonl", *SIGHTS, change=without_what_is_new)
    result = replay(journal, plan())
    assert (result.cycles, result.identical) == (9, 9)
    assert result.events == result.recorded_events


@pytest.mark.parametrize("part", ["commands", "events", "tracks", "safety", "outputs", "rules"])
def test_a_damaged_decision_is_an_error_that_names_its_line(tmp_path, part):
    def damaged(line):
        return line.replace(f'"{part}":', f'"{part}?":') if '"now_s":0.4,' in line else line

    journal = journal_of(tmp_path / "run.jsonl", *SIGHTS, change=damaged)
    with pytest.raises(JournalError, match=r"run\.jsonl:5: not a cycle of a recording: .*`\$\.decision`"):
        replay(journal, plan())


@pytest.mark.long
def test_of_thousands_of_other_decisions_each_counts(tmp_path):
    sights = [2.0, 2.0, *[0.8, 3.0] * 1200]
    result = replay(journal_of(tmp_path / "run.jsonl", *sights), plan(below_m=5.0))
    assert result.cycles == len(sights)
    assert 0 < result.identical < 10
    assert len(result.differences) == 10
    assert result.differences[0].what


def test_what_was_taken_over_while_running_is_handed_over_before_its_first_cycle(tmp_path):
    path = tmp_path / "run.jsonl"
    journal_of(path, *SIGHTS)
    header, *lines = path.read_text().splitlines()
    reload = json.dumps({"reloaded": {"at_s": 0.4, "configuration": {"text": "# another", "files": {}}}})
    path.write_text("\n".join([header, *lines[:4], reload, *lines[4:]]) + "\n")
    handed = []

    def on_reload(state, configuration):
        handed.append((state.now_s, configuration))
        return replace(state, plan=state.plan)

    assert len(list(decisions(read_journal(path), plan(), on_reload))) == 9
    assert handed == [(0.4, RecordedConfiguration(text="# another"))]
    assert replay(read_journal(path), plan()).cycles == 9


def test_the_journal_writes_what_was_taken_over(tmp_path):
    path = tmp_path / "run.jsonl"
    rehearsal = Rehearsal(plan())
    record = CycleRecord(observation=None, decision=rehearsal.see(2.0), applied=(), timings_s={})
    journal = journal_of(path, 2.0)
    (first,) = records_of(journal)
    writer = JournalWriter(path, RecordedConfiguration(text="# configuration"))
    writer.write(first)
    writer.note_reload(1.0, RecordedConfiguration(text="# another", files={"camera.toml": "# lens"}))
    writer.write(replace(record, observation=first.observation))
    writer.close()
    assert [cycle.reloaded for cycle in read_journal(path).cycles()] == [
        None,
        RecordedConfiguration(text="# another", files={"camera.toml": "# lens"}),
    ]


def test_a_damaged_configuration_that_was_taken_over_is_an_error_that_names_its_line(tmp_path):
    path = tmp_path / "run.jsonl"
    journal_of(path, 2.0)
    path.write_text(path.read_text() + '{"reloaded":{"at_s":1.0}}\n')
    with pytest.raises(JournalError, match=r"run\.jsonl:3: not a configuration: .*`configuration`"):
        list(read_journal(path).cycles())


def test_what_a_run_took_over_from_an_earlier_one_is_taken_over_by_its_replay(tmp_path):
    earlier = Rehearsal(plan())
    earlier.see(*[0.8] * 5)
    ended = ClockReading(clock="stepped", at_s=0.5, unix_s=0.0, is_synchronised=False)
    later = Rehearsal(plan())
    later.state = begun = resume(
        later.state, Memory(moment=ended, alarms=snapshot_alarms(earlier.state)), replace(ended, clock="next", at_s=0.0)
    )
    observations = []
    later.cycle = lambda observation: observations.append(observation) or Rehearsal.cycle(later, observation)
    later.see(0.8, 0.8, 3.0, 3.0, 3.0)
    writer = JournalWriter(tmp_path / "run.jsonl", RecordedConfiguration(text=""))
    writer.note_resumption(state_text(begun))
    for observation, (_, decision) in zip(observations, later.decisions, strict=True):
        writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
    writer.close()
    result = replay(read_journal(tmp_path / "run.jsonl"), plan())
    assert result.identical == result.cycles == 5
    assert "raised" not in {event.kind.value for event in result.events}


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 150), marks=pytest.mark.long)])
def test_a_run_with_every_kind_of_rule_replays_to_the_same_decisions_also_from_its_middle(tmp_path, seeds):
    for seed in seeds:
        run, begins = whole_run(seed), 40
        state = initial_state(run.plan)
        writer = JournalWriter(tmp_path / f"{seed}.jsonl", RecordedConfiguration(text=""))
        later = JournalWriter(tmp_path / f"{seed}-later.jsonl", RecordedConfiguration(text=""))
        for cycle, observation in enumerate(run.observations):
            if cycle == begins:
                later.note_resumption(state_text(state))
            state, decision = decide(state, observation)
            record = CycleRecord(observation=observation, decision=decision, applied=(), timings_s={})
            for each in (writer, later) if cycle >= begins else (writer,):
                each.write(record)
        writer.close()
        later.close()
        results = [replay(read_journal(tmp_path / f"{seed}{name}.jsonl"), run.plan) for name in ("", "-later")]
        assert [(each.identical, each.cycles) for each in results] == [(100, 100), (60, 60)], seed


def test_what_was_taken_over_and_is_damaged_is_one_clear_error(tmp_path):
    writer = JournalWriter(tmp_path / "run.jsonl", RecordedConfiguration(text=""))
    writer.note_resumption("[]")
    writer.write(next(records_of(journal_of(tmp_path / "other.jsonl", 2.0))))
    writer.close()
    with pytest.raises(JournalError, match=r"run\.jsonl: not the state of a run"):
        replay(read_journal(tmp_path / "run.jsonl"), plan())
