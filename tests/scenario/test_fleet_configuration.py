"""The whole way of a configuration: git, a real broker, and the real receiver beside a real run, as processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from stadimeter.testing.rig import eventually
from support.broker import HOST, BrokerAccess, MosquittoBroker
from support.command_line import Typed, typed
from support.signing import Repository, allow, make_key
from support.simulated_run import SIMULATED_BALL

ROOM = """
[rules.near]
when = { below = "1 m" }
actuator = "motor"

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""
RULES = '[rules.near]\nwhen = { below = "3 m" }\nactuator = "motor"\n'
FAILING = f"""{RULES}
[[tests]]
name = "calm"
input = {{ hover = {{ at = "50 cm", for = "1 s" }} }}
expect.near = {{ raised = 7 }}
"""
MISSING_BASE = f"""{RULES}
[base]
driver = "roomba"
port = "/dev/tty-that-is-not-there"
"""


class Garage:
    """A device whose run and receiver are processes, and the centre that sends it configurations."""

    def __init__(self, folder: Path, closing: ExitStack) -> None:
        broker = MosquittoBroker(folder, BrokerAccess())
        broker.start()
        closing.callback(broker.stop)
        key = make_key(folder, "ada")
        self.repository = Repository(folder / "repository", key)
        table = f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {broker.port}\nnode = "garage"\n'
        self.centre = folder / "centre.toml"
        self.centre.write_text(table)
        self.path = folder / "garage.toml"
        self.path.write_text(SIMULATED_BALL + ROOM + table)
        allow(key, folder / "signers")
        policy = 'allowed_signers = "signers"\nchange = "all"\nreplay = "required"\nrecording = "journal.jsonl"\n'
        (folder / "fleet.toml").write_text(policy)
        (folder / "rt").mkdir(mode=0o700)
        self._environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder / "rt")}
        self._closing, self._folder = closing, folder
        self._start("run", self.path, "--journal", folder / "journal.jsonl")

    def receive(self) -> None:
        eventually(lambda: self.record().get("status") == "online")
        self._start("fleet", "receive", self.path)
        eventually(lambda: self.record()["configuration"] is not None)

    def _start(self, *words: object) -> None:
        command = [sys.executable, "-m", "stadimeter", *map(str, words)]
        command = ["sh", "-c", 'while :; do "$@"; sleep 1; done', "sh", *command]  # as systemd starts it anew
        log = self._closing.enter_context((self._folder / f"{words[0]}.log").open("ab"))
        process = subprocess.Popen(command, stdout=log, stderr=log, env=self._environment, process_group=0)
        self._closing.callback(process.wait, 120.0)
        self._closing.callback(os.killpg, process.pid, signal.SIGKILL)

    def record(self) -> dict[str, Any]:
        found = typed("fleet", self.centre, "--json", "--wait", "1 s")
        records = json.loads(found.stdout)["devices"] if found.returncode == 0 else []
        return dict(records[0]) if records else {}

    def apply(self, text: str, subject: str) -> Typed:
        file = self.repository.commit(f"{subject}.toml", text, subject)
        words = ("--config", self.centre, "--max-difference", "100", "--wait", "5 s")
        return typed("fleet", "apply", file, *words)


@pytest.fixture
def garage(tmp_path: Path) -> Iterator[Garage]:
    with ExitStack() as closing:
        yield Garage(tmp_path, closing)


@pytest.mark.long
def test_a_run_goes_by_what_is_good_and_by_nothing_else(garage: Garage, tmp_path: Path) -> None:
    garage.receive()
    done = garage.apply(RULES, "good")
    assert done.returncode == 0, done
    assert "near: 1 raised added" in done.stdout
    good = garage.path.read_text()
    assert 'below = "3 m"' in good
    eventually(lambda: garage.record()["configuration_sha256"] == garage.record()["configuration"]["sha256"])

    refused = garage.apply(FAILING, "failing")
    assert "garage refused: 1 of its 1 tests failed: calm" in refused.stderr
    moving = garage.apply(MISSING_BASE, "moving")
    assert "it changes how something moves ([base], " in moving.stderr, moving
    assert garage.path.read_text() == good

    assert typed("fleet", "arm", garage.path).returncode == 0
    ill = garage.apply(MISSING_BASE, "ill")
    assert "garage rolled-back: the run was not well within 120 s" in ill.stderr, ill
    assert "the former file was put back" in ill.stderr
    assert garage.path.read_text() == good
    eventually(lambda: garage.record()["status"] == "online")
    eventually(lambda: garage.record()["configuration_sha256"] == garage.record()["configuration"]["sha256"])
    assert garage.record()["why_not"].startswith("rolled-back: ")
