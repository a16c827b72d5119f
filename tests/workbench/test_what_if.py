"""What changed rules would have done on a recording is what a replay with them says."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.workbench.replay.comparison import ReplayDiff, SideBySide, compare
from stadimeter.workbench.replay.replay import ReplayRun, read_recording
from stadimeter.workbench.replay.what_if import KeptRecording, judged_apart
from support.observing import Rehearsal
from support.saves import LENS

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
when = {{ above = "2 m" }}
{more}
"""
BASE = '[base]\ndriver = "simulated"'
AS_IT_IS = {"below": 1.0, "deadband": 0.0, "on_delay": 0.0, "off_delay": 1.0, "more": ""}


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


def replayed(kept: KeptRecording, new: Configuration) -> tuple[ReplayDiff, SideBySide]:
    """Return what ``replay --config NEW --diff OLD`` compares."""
    beside = SideBySide(ReplayRun(kept.recording, kept.configuration), ReplayRun(kept.recording, new))
    beside.go_on(math.inf)
    return beside.difference(), beside


def without_counts(diff: ReplayDiff) -> list[str]:
    """Return the changes without the count of each event, which goes on over those of rules that were not judged."""
    return sorted(repr(replace(each, event=replace(each.event, sequence=0))) for each in diff.changes)


@pytest.mark.long
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    below=st.sampled_from([0.6, 0.9, 1.0, 1.3, 2.0]),
    deadband=st.sampled_from([0.0, 0.2]),
    on_delay=st.sampled_from([0.0, 0.5, 2.0]),
    off_delay=st.sampled_from([0.0, 1.0, 3.0]),
)
def test_it_is_what_a_replay_says(kept: KeptRecording, **changes: float) -> None:
    new = load(kept.configuration.path.parent, **changes)
    after = kept.decide_with(new.plan)
    diff, beside = replayed(kept, new)
    found = compare(kept.side.tally, after.tally)
    assert without_counts(found) == without_counts(diff)
    assert (found.rules, found.same, found.minutes) == (diff.rules, diff.same, diff.minutes)
    assert {name: lane.spans for name, lane in after.rules.items()} == {
        name: lane.spans for name, lane in beside.new.rules.items()
    }


@pytest.mark.long
def test_only_what_depends_on_a_changed_rule_is_judged_again(kept: KeptRecording) -> None:
    new = load(kept.configuration.path.parent, below=2.0)
    names = [new.plan.rules[each].name for each in judged_apart(kept.configuration.plan, new.plan) or ()]
    assert names == ["near", "first", "long"], "itself, one of its group, and one that asks for it"


@pytest.mark.long
def test_where_it_is_not_certain_everything_is_decided_again(kept: KeptRecording) -> None:
    more = '[rules.follow]\nfollow = { distance = "1 m" }\nactuator = "base"\nwhen = { rule = "near" }\n' + BASE
    folder = kept.configuration.path.parent
    old, new = load(folder, more=more), load(folder, more=more, below=1.3)
    assert judged_apart(old.plan, new.plan) is None
    again = KeptRecording(recording=kept.recording, configuration=old)
    again.go_on(math.inf)
    diff, _ = replayed(again, new)
    assert compare(again.side.tally, again.decide_with(new.plan).tally).changes == diff.changes
