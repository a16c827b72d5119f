"""What commands answer with ``--json``: its values where they follow from files alone, else the form it has."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.cli.run_control import open_control_socket
from stadimeter.config.loader import load_configuration
from support.command_line import typed
from support.detector_rigs import CAMERA, WALL, ball_at, tag_at
from support.golden import Golden, digest
from support.scenes.render import render
from support.scenes.scene import Scene
from support.simulated_run import LENS, SIMULATED_BALL

CONFIG = Path(__file__).parents[2] / "config"
RULES = Path(__file__).with_name("rules.toml")
ROLLING = (
    SIMULATED_BALL
    + """
[rules.near]
actuator = "motor"
when = { below = "1.5 m" }
ack = "required"
latch = true
shelve_max = "1 h"

[rules.far]
when = { all = [{ above = "2 m" }, { seen = true }] }

[safety]
arm = "by-command"

[world]
loop = false
path = [{ at = "0 s", x = "2.5 m", y = "0 m" }, { at = "3 s", x = "1 m", y = "0.2 m" }]
"""
)
ROOM = """
[camera]
driver = "images"
paths = ["tag.png"]
rate = "10 Hz"
[targets.sign]
detector = "tag"
side = "10 cm"
id = 10
"""
PLACES = """
[landmarks]
tag_size = "10 cm"
[[landmarks.tags]]
id = 7
facing = "180 deg"
at = ["0.8 m", "0 m", "0 m"]
"""
EVENTS = """\
2026-07-01 12:00:00.000+02:00  warning: near raised: 0.45 m
2026-07-01 12:00:01.000+02:00? warning: near cleared
7 lines before this one are missing: disk full
"""

ORDERS = (
    ("status",), ("outputs", "arm"), ("outputs", "stop"), ("outputs", "release"), ("outputs", "disarm"),
    ("reload",),
    ("explain", "near"), ("alarm", "observe", "near"), ("alarm", "act", "near"), ("alarm", "ack", "near"),
    ("alarm", "shelve", "near", "--for", "1 min"), ("alarm", "unshelve", "near"),
)  # fmt: skip
"""What a run is asked, one after the other."""


def test_what_follows_from_files_is_answered_as_it_was(
    golden: Golden, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # paths that are told are the same everywhere
    examples = [shutil.copy(path, ".") for path in (*sorted(CONFIG.glob("*.toml")), RULES)]
    Path("rolling.toml").write_text(ROLLING)
    Path("wrong.toml").write_text(ROLLING.replace("below", "blow").replace('"2 m"', '"2 kg"'))
    Path("box.log").write_text(EVENTS)
    _write_journal(Path("rolling.toml"))
    asked: dict[str, tuple[str, ...]] = {
        **{f"check {path}": ("check", path, "--elsewhere") for path in (*examples, "rolling.toml", "wrong.toml")},
        **{f"test {path}": ("test", path) for path in ("appliance.toml", "demo.toml")},
        "replay": ("replay", "rolling.jsonl"),
        "replay by other rules": ("replay", "rolling.jsonl", "--config", "rules.toml"),
        "explain near": ("explain", "near", "--journal", "rolling.jsonl", "--at", "1 s"),
        "explain far": ("explain", "far", "--journal", "rolling.jsonl", "--at", "2.5 s"),
        "events": ("events", "box.log"),
    }
    golden.compare("commands-values", {name: _values(*words) for name, words in asked.items()})


def test_what_the_computer_or_a_picture_has_a_part_in_is_answered_in_the_form_it_was(
    golden: Golden, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lens.toml").write_text(LENS.replace("[camera.model]", ""))
    (tmp_path / "place.toml").write_text(f"{ROOM}{LENS}{PLACES}")
    for name, target in (("ball", ball_at((0.1, 0.0, 0.6))), ("tag", tag_at((0.0, 0.0, 0.8)))):
        cv2.imwrite(f"{name}.png", render(Scene(camera=CAMERA, target=target, seed=3, backdrop=WALL)).image)
    asked: dict[str, tuple[str, ...]] = {
        "measure": ("measure", "ball.png", "--camera", "lens.toml", "--ball", "6.7cm", "--hsv", "29,86,6:64,255,255"),
        "colour": ("colour", "ball.png"),
        "measure --where": ("measure", "tag.png", "--where", "--config", "place.toml"),
    }
    rows = {name: _form(typed(*words, "--json").stdout) for name, words in asked.items()}
    rows["doctor"] = ", ".join(json.loads(typed("doctor", "--json").stdout))
    golden.compare("commands-forms", rows)


def test_a_run_answers_in_the_form_it_did(golden: Golden, tmp_path: Path) -> None:
    config = tmp_path / "standing.toml"
    config.write_text(ROLLING.replace('x = "2.5 m"', 'x = "1 m"'))
    with _running(config) as socket:
        rows = {" ".join(words): _form(typed(*words, "--socket", socket, "--json").stdout) for words in ORDERS}
    golden.compare("commands-run", rows)


def _values(*words: str) -> str:
    """Return the exit code of a command, and a digest of each part of its answer."""
    done = typed(*words, "--json")
    lines = done.stdout.splitlines()
    found = (
        [json.loads(line) for line in lines] if len(lines) > 1 and lines[0].endswith("}") else json.loads(done.stdout)
    )
    parts = {"lines": found} if isinstance(found, list) else found
    return f"exit {done.returncode} " + " ".join(f"{key} {digest(value)}" for key, value in parts.items())


def _form(printed: str) -> str:
    """Return the form of an answer."""
    return " ".join(_form_of(json.loads(line)) for line in printed.splitlines() if line) or "nothing"


def _form_of(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_form_of(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + (_form_of(value[0]) if value else "") + "]"
    return {int: "number", float: "number"}.get(type(value), type(value).__name__)


def _write_journal(config: Path) -> None:
    """Run a configuration, and write its journal beside it."""
    configuration = load_configuration(config)
    loop = Loop(build(configuration, speed=None))
    writer = JournalWriter(config.with_suffix(".jsonl"), to_be_recorded(configuration), "2026-07-01T12:00:00+00:00")
    loop.listeners.append(writer.write)
    loop.run(Limits(seconds=4))
    writer.close()


@contextmanager
def _running(config: Path) -> Iterator[Path]:
    """Have a configuration run in a thread until its alarm was raised, and yield its control socket."""
    loop, is_raised = Loop(build(load_configuration(config))), threading.Event()

    def listen(record: CycleRecord, _frame: object) -> None:
        if any(event.kind == "raised" for event in record.decision.events):
            is_raised.set()

    loop.listeners.append(listen)
    thread = threading.Thread(target=loop.run)
    with ExitStack() as closing:
        open_control_socket(loop, config.with_name("run.sock"), closing)
        thread.start()
        try:
            assert is_raised.wait(120)
            yield config.with_name("run.sock")
        finally:
            loop.end("the test is over")
            thread.join(120)
