"""The commands ``explain`` and ``events``."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.cli import events
from stadimeter.cli.explain import seconds_ago, seconds_since_the_beginning
from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from support.command_line import typed

# ``stadimeter explain``: what is said of a rule at a moment of a recording, or of a running instance.

CONFIG = """
[camera]
driver = "simulated"
rate = "10 Hz"
render = false
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
[targets.ball]
detector = "ideal"
diameter = "20 cm"
[actuators.buzzer]
driver = "simulated"
[rules.near]
actuator = "buzzer"
when = { below = "2 m" }
[rules.both]
when = { all = [ { below = "2 m" }, { not = { lost = true } } ] }
[world]
ball_diameter = "20 cm"
loop = false
path = [ { at = "0 s", x = "4 m", y = "0 m" }, { at = "4 s", x = "1 m", y = "0 m" } ]
"""


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """The journal of a ball that rolls from 4 m to 1 m in four seconds."""
    folder = tmp_path_factory.mktemp("explain")
    (folder / "rules.toml").write_text(CONFIG)
    loop = Loop(build(load_configuration(folder / "rules.toml"), speed=None))
    recorder = Recorder(JournalWriter(folder / "run.jsonl", RecordedConfiguration(text=CONFIG)), is_live=False)
    loop.listeners.append(recorder)
    loop.run(Limits(seconds=6))
    recorder.close()
    return folder / "run.jsonl"


def explained(journal, *arguments):
    done = typed("explain", *arguments, "--journal", journal)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_condition_with_parts_is_shown_part_by_part(journal):
    lines = explained(journal, "both", "--at", "5").splitlines()
    assert lines[0].startswith("At 5.00 s: both: raised ")
    assert [line.split()[0] for line in lines[1:]] == ["yes", "no"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("neer",), "there is no rule 'neer' (did you mean 'near'?)"),
        (("near", "--at", "noon"), "'noon' is no moment"),
        (("near", "--at", "100 s"), "and the recording ends after"),
        (("near", "--at", "-3 s"), "-3 s"),
    ],
)
def test_a_wrong_question_is_answered_with_what_is_wrong_with_it(journal, arguments, words):
    done = typed("explain", *arguments, "--journal", journal)
    assert done.returncode == 2
    assert words in done.stderr


BEGAN = "2026-06-01T23:59:30+00:00"


def test_moments_are_read_in_several_forms():
    for at, seconds in [
        ("12.5", 12.5),
        ("12.5 s", 12.5),
        ("250 ms", 0.25),
        ("2 min", 120.0),
        ("2026-06-01T23:59:40+00:00", 10.0),
    ]:
        assert seconds_since_the_beginning(at, BEGAN) == pytest.approx(seconds)


def test_a_moment_that_is_over_is_read_as_a_time_of_day_or_as_how_long_ago():
    from datetime import datetime

    now = datetime.fromisoformat("2026-06-02T00:00:10+00:00").astimezone()
    assert seconds_ago("5 s", now) == 5
    just = now.replace(microsecond=0)
    assert seconds_ago(f"{just:%H:%M:%S}", now) == pytest.approx(0, abs=1)


# The command that prints the event log.


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(events, "SERVICE_STATE", tmp_path)
    return tmp_path


def printed(*words: object) -> Result:
    return CliRunner().invoke(app, ["events", *map(str, words)])


def test_the_newest_lines_of_all_files_are_printed_in_the_order_of_time(folder: Path) -> None:
    for name, numbers in (("box.log.2", (1, 2)), ("box.log.1", (3, 4)), ("box.log", (5, 6))):
        (folder / name).write_text("".join(f"line {number}\n" for number in numbers))
    assert printed().stdout.splitlines() == [f"line {number}" for number in range(1, 7)]
    assert printed("-n", 3).stdout.splitlines() == ["line 4", "line 5", "line 6"]
    assert printed(folder / "box.log", "--lines", 1).stdout == "line 6\n"


def test_without_a_log_it_says_who_keeps_one(folder: Path) -> None:
    found = printed()
    assert (found.exit_code, found.stderr) == (
        2,
        f"error: there is no event log in {folder}: only a service keeps one; or name the LOG\n",
    )
    assert printed(folder / "absent.log").exit_code == 2


@pytest.mark.parametrize("start", [b'{"format":"stadimeter journal"}\n', b"\x89MCAP0\r\n"])
def test_a_recording_is_no_log_and_the_commands_that_read_one_are_named(folder: Path, start: bytes) -> None:
    (folder / "run.jsonl").write_bytes(start)
    found = printed(folder / "run.jsonl")
    assert (found.exit_code, found.stdout) == (2, "")
    assert "`stadimeter replay" in found.stderr
    assert "explain RULE --journal" in found.stderr


def test_what_is_no_text_is_no_log_and_is_not_printed(folder: Path) -> None:
    (folder / "ball.jpg").write_bytes(b"\xff\xd8\xff\xe0\0\x10JFIF")
    found = printed(folder / "ball.jpg")
    assert (found.exit_code, found.output) == (2, f"error: {folder / 'ball.jpg'} is no event log\n")


def test_a_pipe_is_no_log_and_is_not_waited_for(folder: Path) -> None:
    os.mkfifo(folder / "box.log")
    assert printed().exit_code == 2
