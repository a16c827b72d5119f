"""An alarm that fired wrongly, mended by its recordings: the operations that the page asks for."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.config.rule_test_tables import SpanTable
from stadimeter.errors import ChangedMeanwhileError, ConfigError
from stadimeter.workbench.rule_tests import run_rule_test
from stadimeter.workbench.saving import versions
from stadimeter.workbench.server.operations import Desk, find_operation
from stadimeter.workbench.server.tuning import tuning_of
from stadimeter.workbench.tune import alarm_named, signal_of, with_settings
from support.false_alarm import BY_S, CONFIGURATION, FRAME_S, STAYED_S, record

BEGAN_S = 1_700_000_000.0
BY, STAYED = f"evening.mcap@{BY_S}s no", f"evening.mcap@{STAYED_S}s fire"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tuned")
    record(folder, BEGAN_S)
    return folder


@pytest.fixture
def desk(recorded: Path) -> Desk:
    (recorded / "stadimeter.toml").write_text(CONFIGURATION)
    return Desk(configuration=recorded / "stadimeter.toml", run_socket=recorded / "none.sock")


def ask(desk: Desk, op: str, **args: object) -> Any:
    waits = {"for_s": 1e6} if op == "tune" else {}
    return find_operation(f"tuning.{op}")(desk, {"rule": "near", **waits, **args}).data


@pytest.mark.long
def test_a_dragged_threshold_says_how_many_alarms_come_and_go(desk: Desk) -> None:
    found = ask(desk, "tune", changes={"below": 0.8})
    assert found["words"] == (
        "near would have fired 2 times in 4 minutes of 1 recording: 0 of them new, 2 of yours gone."
    )
    (recording,) = found["recordings"]
    assert (len(recording["before"]), len(recording["after"])) == (4, 2)
    assert recording["began_unix_s"] == pytest.approx(BEGAN_S + FRAME_S, abs=0.01), "its first cycle"
    assert found["settings"]["below"] == {"value": 1.0, "unit": "m"}
    assert found["is_done"]


@pytest.mark.long
def test_what_hundreds_of_settings_are_tried_with_comes_to_the_cores_own_verdict(desk: Desk) -> None:
    tuning = tuning_of(desk, [])
    tuning.go_on(math.inf)
    (kept,) = tuning.recordings.values()
    for values in (
        {"below": 0.8, "off_delay": 0.0},
        {"below": 0.95, "on_delay": 2.5, "deadband": 0.3},
        {"on_delay": 0.3, "off_delay": 3.0, "deadband": 0.05},
    ):
        text = with_settings(tuning.configuration, tuning.text, "near", values)
        changed = load_configuration(desk.configuration, texts={desk.configuration: text})
        _, alarm = alarm_named(changed, "near")
        quickly = signal_of(kept.cycles, alarm, alarm.condition).firings(alarm, alarm.condition)
        assert quickly == [
            pytest.approx(span, abs=FRAME_S / 2) for span in kept.with_plan(changed.plan, "near").spans("near")
        ]


@pytest.mark.long
def test_the_change_is_saved_with_a_test_that_fails_without_it(desk: Desk) -> None:
    taught = ask(desk, "tune", marks=[BY, STAYED])
    saved = ask(desk, "save", changes=taught["changes"], marks=[BY, STAYED], base_version=taught["version"])
    assert saved["tests"] == ["near as tuned: near-evening"]
    text = desk.configuration.read_text()
    (former,) = versions(desk.configuration)[:1]
    assert (former.folder / "stadimeter.toml").read_text() == CONFIGURATION
    after = load_configuration(desk.configuration)
    (test,) = after.tests
    assert run_rule_test(after, test).passed
    assert (desk.configuration.parent / test.input.journal).stat().st_size < 3_000_000
    unchanged = CONFIGURATION + text[text.index("\n[[tests]]") :]
    before = load_configuration(desk.configuration, texts={desk.configuration: unchanged})
    assert not run_rule_test(before, before.tests[0]).passed


def journals(desk: Desk) -> set[Path]:
    return set((desk.configuration.parent / "tests").glob("*"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("at_s", "changes"), [(239.9, {"below": 0.8}), (0.0, {"off_delay": 3.0}), (151.0, {"below": 0.8})]
)
def test_a_saved_test_passes_at_once_and_never_reaches_beyond_its_recording(
    desk: Desk, at_s: float, changes: dict[str, float]
) -> None:
    marks = [f"evening.mcap@{at_s}s no", f"evening.mcap@{max(0.0, at_s - 6)}s..{at_s}s no"]
    version = ask(desk, "tune", changes=changes)["version"]
    assert len(ask(desk, "save", changes=changes, marks=marks, base_version=version)["tests"]) == 1
    after = load_configuration(desk.configuration)
    (result,) = (run_rule_test(after, each) for each in after.tests)
    assert result.failures == ()
    named = result.test.expect["near"].inactive_at or []
    assert max(each.end_s if isinstance(each, SpanTable) else each for each in named) <= result.took_s


@pytest.mark.long
def test_what_another_has_saved_meanwhile_is_not_overwritten(desk: Desk) -> None:
    seen, before = ask(desk, "tune", changes={"below": 0.8}), journals(desk)
    theirs = CONFIGURATION + "# by another\n"
    desk.configuration.write_text(theirs)
    for version in (seen["version"], ""):
        with pytest.raises(ChangedMeanwhileError, match="was changed by another since you read it; nothing was saved"):
            ask(desk, "save", changes={"below": 0.8}, base_version=version)
    assert desk.configuration.read_text() == theirs
    assert journals(desk) == before


@pytest.mark.long
def test_marks_that_are_not_met_are_not_saved_as_a_test_that_fails(desk: Desk) -> None:
    version, before = ask(desk, "tune", changes={"below": 0.8})["version"], journals(desk)
    with pytest.raises(
        ConfigError, match=f"nothing was saved, for with these settings this would fail: evening.mcap@{STAYED_S:g}s"
    ):
        ask(desk, "save", changes={"below": 0.01}, marks=[STAYED], base_version=version)
    assert desk.configuration.read_text() == CONFIGURATION
    assert journals(desk) == before


@pytest.mark.long
def test_a_change_after_which_a_test_would_fail_that_passes_is_refused(desk: Desk) -> None:
    hover = "{ hover = { at = '90 cm', for = '20 s' } }"
    text = f"{CONFIGURATION}\n[[tests]]\nname = 'at 90 cm'\ninput = {hover}\nexpect.near.raised = 1\n"
    desk.configuration.write_text(text)
    version, before = ask(desk, "tune", changes={"below": 0.8})["version"], journals(desk)
    with pytest.raises(ConfigError, match="this would fail: at 90 cm"):
        ask(desk, "save", changes={"below": 0.8}, base_version=version)
    assert desk.configuration.read_text() == text
    assert journals(desk) == before


@pytest.mark.long
def test_a_recording_that_holds_a_moment_is_found(tmp_path: Path) -> None:
    record(tmp_path, time.time() - 1000)
    desk = Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")
    found = ask(desk, "tune", at_s=[time.time() - 900])
    assert [each["name"] for each in found["recordings"]] == ["evening.mcap"]


@pytest.mark.long
def test_a_clip_of_a_recording_that_is_there_counts_once(desk: Desk) -> None:
    evening = desk.configuration.parent / "recordings" / "evening.mcap"
    clip = evening.parent / "clips" / "near.mcap"
    clip.parent.mkdir()
    clip.write_bytes(evening.read_bytes()[: evening.stat().st_size // 2])
    found = ask(desk, "tune")
    assert [each["name"] for each in found["recordings"]] == ["evening.mcap"]
