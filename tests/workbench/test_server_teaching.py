"""An alarm that fired wrongly, mended by its recordings: the operations that the page asks for."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError
from stadimeter.workbench.rule_tests.running import run_rule_test
from stadimeter.workbench.saving import versions
from stadimeter.workbench.server.operations import Desk, find_operation
from support.false_alarm import BY_S, CONFIGURATION, FRAME_S, STAYED_S, record

BEGAN_S = 1_700_000_000.0
BY, STAYED = f"evening.mcap@{BY_S}s no", f"evening.mcap@{STAYED_S}s fire"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("taught")
    record(folder, BEGAN_S)
    return folder


@pytest.fixture
def desk(recorded: Path) -> Desk:
    (recorded / "stadimeter.toml").write_text(CONFIGURATION)
    return Desk(configuration=recorded / "stadimeter.toml", run_socket=recorded / "none.sock")


def ask(desk: Desk, op: str, **args: object) -> Any:
    waits = {"for_s": 1e6} if op == "what_if" else {}
    return find_operation(f"teaching.{op}")(desk, {"rule": "near", **waits, **args}).data


@pytest.mark.long
def test_a_dragged_threshold_says_how_many_alarms_come_and_go(desk: Desk) -> None:
    found = ask(desk, "what_if", changes={"below": 0.8})
    assert found["words"] == (
        "near would have fired 2 times in 4 minutes of 1 recording: 0 of them new, 2 of yours missed."
    )
    (recording,) = found["recordings"]
    assert (len(recording["before"]), len(recording["after"])) == (4, 2)
    assert recording["began_unix_s"] == pytest.approx(BEGAN_S + FRAME_S, abs=0.01), "its first cycle"
    assert found["settings"]["below"] == {"value": 1.0, "unit": "m"}
    assert found["is_done"]


@pytest.mark.long
def test_what_is_asked_again_reads_no_recording_again(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    ask(desk, "what_if", changes={"below": 0.8})
    monkeypatch.setattr("stadimeter.workbench.teaching.lesson.read_recording", None)
    assert "1 of them new" not in ask(desk, "what_if", changes={"below": "70 cm", "off_delay": 3.0})["words"]


@pytest.mark.long
def test_a_desk_at_rest_keeps_no_recording_and_reads_it_again_when_it_is_asked(desk: Desk) -> None:
    for _ in range(2):
        told = ask(desk, "what_if", changes={"below": 0.8})["words"]
        (rest,) = desk.at_rest
        rest()
        assert desk.kept["lesson"] is None
        assert "2 of yours missed" in told


def test_before_anything_is_read_the_answer_says_that_more_is_to_come(desk: Desk) -> None:
    found = ask(desk, "what_if", for_s=0.0)
    assert not found["is_done"]
    assert found["recordings"][0]["before"] == []


@pytest.mark.long
def test_marks_are_met_by_one_setting_that_leaves_all_other_alarms(desk: Desk) -> None:
    found = ask(desk, "teach", marks=[BY, STAYED])
    assert len(found["changes"]) == 1
    (recording,) = found["recordings"]
    assert not any(begin <= BY_S <= end for begin, end in recording["after"])
    assert any(begin <= STAYED_S <= end for begin, end in recording["after"])


@pytest.mark.long
def test_the_change_is_saved_with_a_test_that_fails_without_it(desk: Desk) -> None:
    changes = ask(desk, "teach", marks=[BY, STAYED])["changes"]
    saved = ask(desk, "save", changes=changes, marks=[BY, STAYED])
    assert [each["ok"] for each in saved["tests"]] == [True]
    text = desk.configuration.read_text()
    (former,) = versions(desk.configuration)[:1]
    assert (former.folder / "stadimeter.toml").read_text() == CONFIGURATION
    (test,) = load_configuration(desk.configuration).tests
    assert (desk.configuration.parent / test.input.journal).stat().st_size < 3_000_000
    unchanged = CONFIGURATION + text[text.index("\n[[tests]]") :]
    before = load_configuration(desk.configuration, texts={desk.configuration: unchanged})
    assert not run_rule_test(before, before.tests[0]).passed


@pytest.mark.long
def test_a_dragged_threshold_is_saved_with_the_alarms_that_went(desk: Desk) -> None:
    saved = ask(desk, "save", changes={"below": 0.8})
    assert [each["ok"] for each in saved["tests"]] == [True]
    assert "inactive_at" in desk.configuration.read_text()


@pytest.mark.long
def test_marks_that_contradict_each_other_are_refused_by_name(desk: Desk) -> None:
    with pytest.raises(ConfigError) as refused:
        ask(desk, "teach", marks=["evening.mcap@92s no", "evening.mcap@31.5s fire"])
    words = str(refused.value)
    assert "contradict each other" in words
    assert "evening.mcap@31.5s fire" in words
    assert "the distance reached 0.4" in words or "the distance reached 0.5" in words


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"below": "2 s"}, "'below' is in m"),
        ({"blow": 1.0}, "did you mean 'below'"),
        ({"below": -1.0}, "below"),
    ],
)
def test_what_cannot_be_set_is_said(desk: Desk, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        ask(desk, "what_if", changes=changes)
    assert says in str(refused.value)


@pytest.mark.long
def test_a_recording_that_holds_a_moment_is_found(tmp_path: Path) -> None:
    record(tmp_path, time.time() - 1000)
    desk = Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")
    found = ask(desk, "what_if", at_s=[time.time() - 900])
    assert [each["name"] for each in found["recordings"]] == ["evening.mcap"]


def test_a_moment_that_no_recording_holds_is_looked_for_once(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    ask(desk, "what_if", at_s=[BEGAN_S - 5000])
    monkeypatch.setattr("stadimeter.workbench.teaching.lesson.read_recording", None)
    assert ask(desk, "what_if", at_s=[BEGAN_S - 5000])["is_done"]
