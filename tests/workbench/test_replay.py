"""Replays: read no further than need be and never wrong for it, and what other rules change."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import ClockReading, Memory, resume, state_text
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration, read_journal, to_be_recorded
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, Event, EventKind, Severity
from stadimeter.core.observation import Observation
from stadimeter.core.persistence import snapshot_alarms
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.errors import JournalError
from stadimeter.workbench.replay import ReplayRun, decisions, read_recording
from stadimeter.workbench.trial import KeptRecording, SideBySide, Stay, Trial, compare, judged_apart, stays
from support.observing import Rehearsal
from support.random_runs import whole_run
from support.replaying import replay
from support.saves import LENS

# Replays: read no further than need be, and never wrong for it.


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
    with pytest.raises(JournalError, match=r"run\.jsonl:5: not a cycle of a recording: Object missing"):
        replay(journal, plan())


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


# What other rules change over a recording: events, chatter, lateness, what they let pass.

FRAME_S = 0.05


def plan_of_alarm(below_m=1.0, **changes):
    alarm = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=below_m), off_delay_s=0.0)
    return Plan(targets=("ball",), rules=(replace(alarm, **changes),))


def tallied(rules, distances_m):
    class Tallied(Rehearsal):
        def cycle(self, observation):
            decision = super().cycle(observation)
            trial.add(observation, decision)
            return decision

    trial = Trial(plan=rules)
    Tallied(rules, frame_s=FRAME_S).see(*distances_m)
    return trial


def way(*legs):
    """Return distances a frame at a time: of each leg from where, to where, at what speed."""
    distances_m = []
    for from_m, to_m, speed_mps in legs:
        frames = round(abs(to_m - from_m) / speed_mps / FRAME_S)
        distances_m += [from_m + (to_m - from_m) * number / frames for number in range(frames)]
    return distances_m


IN_AND_OUT = way((3.0, 0.5, 0.5), (0.5, 3.0, 0.5))


def kinds(diff):
    return [(change.change, change.event.kind.value, change.event.source) for change in diff.changes]


def test_a_nearer_limit_moves_the_alarm_later_and_its_end_earlier():
    diff = compare(tallied(plan_of_alarm(1.2), IN_AND_OUT), tallied(plan_of_alarm(1.0), IN_AND_OUT))
    raised, cleared = diff.changes
    assert (raised.change, raised.event.kind, cleared.change, cleared.event.kind) == (
        "moved",
        EventKind.RAISED,
        "moved",
        EventKind.CLEARED,
    )
    assert raised.by_s == pytest.approx(0.2 / 0.5, abs=0.11)
    assert cleared.by_s == pytest.approx(-0.2 / 0.5, abs=0.11)


def test_a_limit_that_is_never_crossed_loses_the_alarm_and_the_other_way_round_adds_it():
    crossed, never = tallied(plan_of_alarm(1.0), IN_AND_OUT), tallied(plan_of_alarm(0.3), IN_AND_OUT)
    assert kinds(compare(crossed, never)) == [("lost", "raised", "near"), ("lost", "cleared", "near")]
    assert kinds(compare(never, crossed)) == [("added", "raised", "near"), ("added", "cleared", "near")]


def test_an_on_delay_shows_as_lateness_and_as_distance_let_pass():
    prompt = tallied(plan_of_alarm(), IN_AND_OUT).figures()[0]
    slow = tallied(plan_of_alarm(on_delay=OnDelay(hold_s=0.5)), IN_AND_OUT).figures()[0]
    assert prompt.late_worst_s == pytest.approx(0.0, abs=0.1)
    assert slow.late_worst_s == pytest.approx(0.5, abs=0.12)
    assert (slow.missed, slow.unfounded) == (0, 0)


def test_a_crossing_that_raised_nothing_is_missed():
    figures = tallied(plan_of_alarm(on_delay=OnDelay(hold_s=60.0)), IN_AND_OUT).figures()[0]
    assert (figures.raised, figures.missed, figures.late_worst_s) == (0, 1, None)


def seconds(count):
    return [number * FRAME_S for number in range(count)]


def test_the_moment_of_a_crossing_is_found_between_frames_and_without_delay():
    distances_m = [2.0 - 1.0 * at_s for at_s in seconds(40)]
    (stay,) = stays(seconds(40), distances_m, (-math.inf, 1.123))
    assert stay == Stay(pytest.approx(0.877, abs=1e-6), pytest.approx(39 * FRAME_S), is_entered=True)


@given(
    distances_m=st.lists(st.floats(0.1, 10) | st.just(math.nan), max_size=60),
    gaps_s=st.lists(st.floats(0.01, 2), min_size=60, max_size=60),
)
def test_stays_are_in_order_apart_and_within_what_was_measured(distances_m, gaps_s):
    at_s = [sum(gaps_s[: number + 1]) for number in range(len(distances_m))]
    found = stays(at_s, distances_m, (1.0, 3.0))
    bounds_s = [bound_s for stay in found for bound_s in (stay.from_s, stay.to_s)]
    assert bounds_s == sorted(bounds_s)
    assert all(at_s[0] <= bound_s <= at_s[-1] for bound_s in bounds_s)


@given(
    old_s=st.lists(st.floats(0, 100), max_size=12).map(sorted),
    new_s=st.lists(st.floats(0, 100), max_size=12).map(sorted),
)
def test_every_event_is_counted_once(old_s, new_s):
    def raised(times_s):
        trial = Trial(plan=plan_of_alarm())
        trial.events = [
            Event(kind=EventKind.RAISED, source="near", at_s=at_s, severity=Severity.ALARM, reason="")
            for at_s in times_s
        ]
        return trial

    diff = compare(raised(old_s), raised(new_s))
    count = {name: sum(change.change == name for change in diff.changes) for name in ("added", "lost", "moved")}
    assert diff.same_events + count["moved"] + count["lost"] == len(old_s)
    assert diff.same_events + count["moved"] + count["added"] == len(new_s)
    assert all(abs(change.by_s) <= 5.0 for change in diff.changes)


# What changed rules would have done on a recording is what a replay with them says.

RULES = """
[camera]
driver = "simulated"
model = "camera.toml"
[targets.ball]
detector = "ideal"
[actuators.buzzer]
driver = "simulated"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
[rules.near]
group = "one"
actuator = "buzzer"
when = {{ below = "{below} m", deadband = "{deadband} m" }}
on_delay = "{on_delay} s"
off_delay = "{off_delay} s"
lost = {{ policy = "clear" }}
[rules.first]
group = "one"
when = {{ below = "1.5 m" }}
[rules.long]
when = {{ rule = "near" }}
on_delay = "3 s"
[rules.apart]
when = {{ below = "{apart_below} m", deadband = "{apart_deadband} m" }}
on_delay = "{apart_on_delay} s"
off_delay = "{apart_off_delay} s"
{more}
"""
BASE = '[base]\ndriver = "simulated"'
SETTINGS = {"below": 1.0, "deadband": 0.0, "on_delay": 0.0, "off_delay": 1.0}
AS_IT_IS = {**SETTINGS, **{f"apart_{key}": value for key, value in SETTINGS.items()}, "more": ""}


def load(folder: Path, **changes: object) -> Configuration:
    (folder / "camera.toml").write_text(camera_file_text(LENS))
    place = folder / "stadimeter.toml"
    return load_configuration(place, texts={place: RULES.format(**{**AS_IT_IS, **changes})})


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> KeptRecording:
    """Return a recording of a ball that comes and goes, is lost, and of an operator who shelves."""
    folder = tmp_path_factory.mktemp("what-if")
    configuration = load(folder)
    writer = JournalWriter(folder / "run.jsonl", to_be_recorded(configuration))

    class Recorded(Rehearsal):
        def cycle(self, observation: Observation) -> Decision:
            decision = super().cycle(observation)
            writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
            return decision

    rehearsal = Recorded(configuration.plan)
    for part in range(4):
        rehearsal.see(*(1.6 + 1.1 * math.sin((each + 400 * part) / 23) * math.sin(each / 7) for each in range(250)))
        rehearsal.see(*[None] * 80)
        rehearsal.tell("shelve", "near", for_s=5.0)
        rehearsal.wait(1.0)
    writer.close()
    found = KeptRecording(recording=read_recording(folder / "run.jsonl"), configuration=configuration)
    found.go_on(math.inf)
    return found


@pytest.mark.long
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rule=st.sampled_from(["near", "long", "apart"]),
    below=st.sampled_from([0.6, 0.9, 1.0, 1.3, 2.0]),
    deadband=st.sampled_from([0.0, 0.2]),
    on_delay=st.sampled_from([0.0, 0.5, 2.0]),
    off_delay=st.sampled_from([0.0, 1.0, 3.0]),
)
def test_a_rule_judged_again_does_what_a_replay_says(kept: KeptRecording, rule: str, **changes: float) -> None:
    changes = {f"apart_{key}" if rule == "apart" else key: value for key, value in changes.items()}
    new = load(kept.configuration.path.parent, **changes)
    after = kept.with_plan(new.plan, rule)
    beside = SideBySide(ReplayRun(kept.recording, kept.configuration), ReplayRun(kept.recording, new))
    beside.go_on(math.inf)
    assert kept.trial.spans("near") == beside.old.spans("near")
    assert after.spans(rule) == beside.new.spans(rule)
    found, expected = (
        [replace(event, sequence=0) for event in each.events if event.source == rule] for each in (after, beside.new)
    )
    assert found == expected
    assert [each for each in after.figures() if each.rule == rule] == [
        each for each in beside.new.figures() if each.rule == rule
    ]


def test_where_it_is_not_certain_everything_is_decided_again(tmp_path: Path) -> None:
    plan = load(tmp_path).plan
    assert judged_apart(plan, "apart") == (3,), "it asks for no other"
    assert judged_apart(plan, "near") == (0, 1), "it is in a group"
    assert judged_apart(plan, "long") == (0, 1, 2), "it asks for one that is in a group"
    follow = '[rules.follow]\nfollow = { distance = "1 m" }\nactuator = "base"\n'
    more = f'{follow}[rules.driving]\nwhen = {{ rule = "follow" }}\n{BASE}'
    assert judged_apart(load(tmp_path, more=more).plan, "driving") is None
