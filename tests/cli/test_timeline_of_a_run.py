"""A run keeps its timeline: as a service, or where its configuration says so; a kill leaves what was written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stadimeter.app.event_log import read_events
from stadimeter.app.timeline import MEAN, event_log_beside, read_rows
from stadimeter.testing.rig import eventually
from support.simulated_run import SIMULATED_BALL

ROOM = f"""{SIMULATED_BALL}
[rules.near]
actuator = "motor"
when = {{ below = "3 m" }}
on_delay = "0 s"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
"""


def start(folder: Path, table: str, **environ: str) -> subprocess.Popen[bytes]:
    path = folder / "room.toml"
    path.write_text(table + ROOM)
    command = [sys.executable, "-m", "stadimeter", "run", str(path), "--no-state"]
    own = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    own.pop("STATE_DIRECTORY", None)
    return subprocess.Popen(command, env={**own, **environ}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.long
@pytest.mark.parametrize("is_service", [True, False])
def test_a_run_that_is_killed_has_kept_its_first_second_and_its_events(tmp_path: Path, is_service: bool) -> None:
    state = tmp_path / "state"
    state.mkdir()
    if is_service:
        run = start(tmp_path, "", STATE_DIRECTORY=str(state))
    else:
        run = start(tmp_path, '[timeline]\nkeep = "1 d"\n')
    folder = (state if is_service else tmp_path) / "timeline" / "room"
    log = state / "room.log" if is_service else event_log_beside(folder)
    try:
        eventually(lambda: list(read_rows(folder, 0, 2**32, 1)) and list(read_events(log, 0, 2**32)))
    finally:
        run.send_signal(signal.SIGKILL)
        run.wait()
    ((names, rows),) = read_rows(folder, 0, 2**32, 1)
    assert (names.targets, names.rules) == (("ball",), ("near",))
    mean_m = rows["figures"][0, 0, MEAN]  # of a second that was over before the ball was tracked there is none
    assert np.isnan(mean_m) or mean_m == pytest.approx(2.0, abs=0.1)
    assert [each.reason[:7] for each in read_events(log, 0, 2**32)][-1] == "started"


@pytest.mark.long
@pytest.mark.parametrize(("table", "environ"), [("", {}), ('[timeline]\nkeep = "0 s"\n', {"STATE_DIRECTORY": "state"})])
def test_a_run_at_a_desk_without_a_table_and_one_that_shall_keep_nothing_leave_no_folder(
    tmp_path: Path, table: str, environ: dict[str, str]
) -> None:
    (tmp_path / "state").mkdir()
    own = {name: str(tmp_path / value) for name, value in environ.items()}
    run = start(tmp_path, table, **own)
    eventually(lambda: list(tmp_path.rglob("*.sock")))
    run.send_signal(signal.SIGTERM)
    run.wait()
    assert not list(tmp_path.rglob("timeline"))
