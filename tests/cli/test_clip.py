"""Clips by order: in another terminal, across a reload, and in a run that is asked to end meanwhile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay.recording_reader import read_mcap
from support.command_line import typed
from support.simulated_run import SIMULATED_BALL

WORLD = '\n[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m" }]\nloop = false\n'
RULE = '\n[rules.near]\nactuator = "motor"\nwhen = { below = "1 m" }\n'
BOX = '\n[black_box]\nbefore = "30 s"\nafter = "60 s"\non = ["fault"]\n'


@pytest.mark.long
def test_a_clip_spans_a_reload_ends_whole_at_sigterm_and_replays(tmp_path: Path) -> None:
    path = tmp_path / "door.toml"
    path.write_text(SIMULATED_BALL + RULE + BOX + WORLD)
    folders = {"XDG_RUNTIME_DIR": str(tmp_path / "r"), "XDG_STATE_HOME": str(tmp_path / "s")}
    environ = {name: value for name, value in os.environ.items() if not name.endswith("_DIRECTORY")} | folders
    command = [sys.executable, "-m", "stadimeter", "run", str(path)]
    run = subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        eventually(lambda: typed("status", env=environ).returncode == 0)
        path.write_text(path.read_text().replace("1 m", "3 m"))
        assert typed("reload", env=environ).returncode == 0
        done = typed("clip", "--by", "zoe", "--why", "a noise", "--json", env=environ)
        assert done.returncode == 0
        clip = tmp_path / "recordings" / "clips" / json.loads(done.stdout)["clip"]
        eventually(clip.exists)
    finally:
        run.send_signal(signal.SIGTERM)
        _, said = run.communicate(timeout=60)
    assert "black box" not in said
    found = read_mcap(clip)
    assert not found.is_cut_off()
    assert found.clip_of == {"kind": "order", "source": "zoe", "reason": "a noise"}
    assert any(cycle.reloaded is not None for cycle in found.cycles())
    replayed = typed("replay", str(clip), "--strict", env=environ)
    assert replayed.returncode == 0
    assert "raised" in replayed.stdout
    explained = typed("explain", "near", "--journal", str(clip), env=environ)
    assert "near" in explained.stdout
    assert explained.returncode == 0


def test_a_configuration_says_what_its_black_box_takes_and_what_is_wrong_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from stadimeter.app.this_computer import warnings_here
    from stadimeter.config.describe import describe
    from stadimeter.config.loader import load_configuration
    from stadimeter.errors import ConfigError

    path = tmp_path / "door.toml"
    path.write_text(SIMULATED_BALL + RULE + BOX + 'memory = "16 MB"\n' + WORLD)
    words = "Keeps the last 30 s with pictures in at most 16 MB of memory, and writes a clip on each fault: "
    assert words + "500 MB of clips at most." in describe(load_configuration(path))
    wrong = 'before = "0.5 s"\nafter = "1 h"\nrate = "0 Hz"\nquality = 101\nmemory = "1 MB"\nmax_total = "5"\n'
    wrong += 'on = ["all"]\n'
    path.write_text(SIMULATED_BALL + RULE + "\n[black_box]\n" + wrong + WORLD)
    with pytest.raises(ConfigError) as caught:
        load_configuration(path)
    keys = {"before", "after", "rate", "quality", "memory", "max_total", "on"}
    assert {problem.key.split(".")[1] for problem in caught.value.problems} == keys
    monkeypatch.setattr("stadimeter.app.this_computer.missing", lambda extra: f"no {extra}")
    path.write_text(SIMULATED_BALL + RULE + BOX + WORLD)
    assert "the black box cannot write: no record" in [each.message for each in warnings_here(load_configuration(path))]
    path.write_text(SIMULATED_BALL + RULE + '[buttons.front]\ndriver = "simulated"\npress = "clip"\n' + WORLD)
    (warning,) = (each for each in load_configuration(path).warnings if each.code == "no-black-box")
    assert "there is no black box" in warning.message
