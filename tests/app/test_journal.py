"""The journal and its replay."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration, read_journal
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from stadimeter.errors import JournalError
from support.observing import Rehearsal, measured
from support.recordings import records_of
from support.replaying import replay

PLAN = Plan(
    targets=("ball",),
    rules=(
        AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0)),
        RampRule(name="far", target="ball", output="motor", start=3.0, full=6.0),
        FollowRule(name="follow", target="ball", output="base", distance_m=1.0),
    ),
    outputs=(LevelOutput(name="buzzer"), LevelOutput(name="motor"), BaseOutput(name="base")),
)


class Recorder(Rehearsal):
    """A rehearsal that keeps a journal."""

    def __init__(self, path, plan=PLAN):
        super().__init__(plan)
        self.journal = JournalWriter(path, RecordedConfiguration(text="# configuration"))

    def cycle(self, observation):
        decision = super().cycle(observation)
        record = CycleRecord(
            observation=observation, decision=decision, applied=decision.commands, timings_s={"decide": 1e-4}
        )
        self.journal.write(record)
        return decision


def recorded(path, *sights):
    recorder = Recorder(path)
    recorder.see(*sights)
    recorder.wait(0.5)
    recorder.journal.close()
    return recorder


def test_what_is_read_is_what_was_written_to_the_last_bit(tmp_path):
    recorder = recorded(tmp_path / "run.jsonl", 5, 4, None, 0.1 + 0.2, 1 / 3)
    journal = read_journal(tmp_path / "run.jsonl")
    assert [(r.observation.now_s, r.decision) for r in records_of(journal)] == recorder.decisions
    assert journal.header.configuration == "# configuration"


@pytest.mark.long
@given(sights=st.lists(st.none() | st.floats(allow_nan=True, allow_infinity=True) | st.floats(0.1, 8), min_size=1))
def test_even_broken_figures_replay_to_the_same_decisions(tmp_path_factory, sights):
    path = tmp_path_factory.mktemp("journal") / "run.jsonl"
    recorded(path, *sights)
    result = replay(read_journal(path), PLAN)
    assert result.identical == result.cycles


@pytest.mark.parametrize("left", [b'{"stadi', b'{"stadimeter_journal":1,"ver', b"\0" * 500])
def test_a_journal_that_a_power_cut_ended_in_its_first_line_keeps_no_run_from_recording(tmp_path, left):
    (tmp_path / "run.jsonl").write_bytes(left)
    recorded(tmp_path / "run.jsonl", 5, 4)
    assert len(list(records_of(read_journal(tmp_path / "run.jsonl")))) > 2
    assert (tmp_path / "run-1.jsonl").read_bytes() == left


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_is_whole(tmp_path):
    path = tmp_path / "run.jsonl"
    recorded(path, 5, 4, 3)
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    journal = read_journal(path)
    assert journal.is_cut_off()
    assert replay(journal, PLAN).cycles == 7


def test_a_damaged_line_is_named(tmp_path):
    path = tmp_path / "run.jsonl"
    recorded(path, 5, 4, 3)
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace('"now_s"', '"never_s"')
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(JournalError, match=r"run\.jsonl:3: not a cycle of a recording: .*`now_s`"):
        replay(read_journal(path), PLAN)


@pytest.mark.parametrize("content", ["", "hello\n", "{}\n", "[]\n", '{"stadimeter_journal": 1}\n'])
def test_a_file_that_is_no_journal_is_refused(tmp_path, content):
    path = tmp_path / "run.jsonl"
    path.write_text(content)
    with pytest.raises(JournalError, match=r"run\.jsonl"):
        read_journal(path)


def test_a_journal_of_a_later_format_is_refused(tmp_path):
    path = tmp_path / "run.jsonl"
    path.write_text('{"stadimeter_journal": 99}\n')
    with pytest.raises(JournalError, match="format 99; this version of stadimeter reads format 2"):
        read_journal(path)


def a_record():
    decision = Rehearsal(Plan(targets=("ball",))).see(2.0)
    return CycleRecord(observation=Observation(now_s=1.0), decision=decision, applied=(), timings_s={})


def written(path):
    journal = JournalWriter(path, RecordedConfiguration(text=""))
    journal.write(a_record())
    journal.close()
    return journal


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_an_older_journal_is_kept_under_another_name_from_the_first_cycle_on(tmp_path):
    path = tmp_path / "run.jsonl"
    recorded(path, 5, 4, 3)
    old = path.read_bytes()
    JournalWriter(path, RecordedConfiguration(text="")).close()
    assert (names(tmp_path), path.read_bytes()) == (["run.jsonl"], old)
    assert written(path).older_file() == f"{path} held an older journal, which is now {tmp_path / 'run-1.jsonl'}"
    assert len(list(records_of(read_journal(path)))) == 1
    assert (tmp_path / "run-1.jsonl").read_bytes() == old
    written(path)
    assert names(tmp_path) == ["run-1.jsonl", "run-2.jsonl", "run.jsonl"]
    assert (tmp_path / "run-1.jsonl").read_bytes() == old


def test_two_runs_with_one_name_lose_nothing(tmp_path):
    """The second takes the name, and the first goes on in the file that was renamed under it."""
    path = tmp_path / "run.jsonl"
    first, second = (JournalWriter(path, RecordedConfiguration(text="")) for _ in range(2))
    for _ in range(3):
        first.write(a_record())
        second.write(a_record())
    first.close()
    second.close()
    journals = [each for each in tmp_path.iterdir() if each.stat().st_size]
    lengths = {each.name: len(list(records_of(read_journal(each)))) for each in journals}
    assert lengths == {"run.jsonl": 3, "run-1.jsonl": 3}


def test_only_the_user_can_read_a_new_journal_and_an_older_one_keeps_its_mode(tmp_path):
    path = tmp_path / "run.jsonl"
    written(path)
    path.chmod(0o644)
    written(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert (tmp_path / "run-1.jsonl").stat().st_mode & 0o777 == 0o644


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write in every folder")
def test_a_folder_in_which_the_older_one_cannot_be_kept_is_refused_at_once(tmp_path):
    written(tmp_path / "run.jsonl")
    tmp_path.chmod(0o500)
    with pytest.raises(JournalError, match="cannot be written: its folder"):
        JournalWriter(tmp_path / "run.jsonl", RecordedConfiguration(text=""))
    tmp_path.chmod(0o700)


def test_a_file_that_is_no_journal_is_not_overwritten(tmp_path):
    path = tmp_path / "configuration.toml"
    path.write_text("[camera]\n")
    with pytest.raises(JournalError, match="holds something else than a journal; choose another file"):
        JournalWriter(path, RecordedConfiguration(text=""))
    assert path.read_text() == "[camera]\n"


def test_a_tilt_is_recorded_and_a_journal_from_before_tilts_were_measured_is_read(tmp_path):
    path = tmp_path / "run.jsonl"
    tilted = replace(measured("ball", 1.0, 2.0), tilt_rad=1 / 3, ambiguity=0.25)
    observation = Observation(now_s=1.0, frame=FrameStamp(sequence=0, captured_at_s=1.0), measurements=(tilted,))
    writer = JournalWriter(path, RecordedConfiguration(text=""))
    writer.write(replace(a_record(), observation=observation))
    writer.close()
    (record,) = records_of(read_journal(path))
    assert record.observation.measurements == (tilted,)
    header, cycle = path.read_text().splitlines()
    older = cycle.replace(',"tilt_rad":0.3333333333333333,"ambiguity":0.25', "")
    assert older != cycle
    path.write_text(f"{header}\n{older}\n")
    (record,) = records_of(read_journal(path))
    assert record.observation.measurements == (replace(tilted, tilt_rad=None, ambiguity=None),)
