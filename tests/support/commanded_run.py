"""A run in a thread of a test, that other programs command over MQTT."""

from __future__ import annotations

import json
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Loop
from stadimeter.cli.run_control import open_control_socket
from stadimeter.config.loader import load_configuration
from support.simulated_run import SIMULATED_BALL

ROOM = """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
ack = "required"
latch = true
shelve_max = "1 h"

[rules.guarded]
when = { below = "3 m" }
severity = "safety"

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""


class CommandedRun:
    """A run in a thread of this process, connected to a broker."""

    def __init__(self, folder: Path, port: int, closing: ExitStack, **options: str) -> None:
        self.path = folder / "room.toml"
        messenger = {"driver": "mqtt", "port": port, "node": "it", **options}
        table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in messenger.items())
        self.path.write_text(f"{SIMULATED_BALL}{ROOM}\n[messenger]\n{table}")
        self.loop = Loop(build(load_configuration(self.path)))
        self.told: list[str] = []
        self.records: list[Any] = []
        self.loop.services.tell = self.told.append
        self.loop.listeners.append(lambda record, _frame: self.records.append(record))
        open_control_socket(self.loop, folder / "run.sock", closing)
        self._thread = threading.Thread(target=self.loop.run, daemon=True)
        closing.callback(self.end)
        self._thread.start()

    def end(self) -> None:
        """End, and wait for it."""
        self.loop.end("the test is over")
        self._thread.join(120)
        assert not self.is_alive

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended."""
        return self._thread.is_alive()

    @property
    def commands(self) -> dict[str, Any]:
        """What `stadimeter status` says of commands over MQTT."""
        control = self.loop.services.control
        assert control is not None
        return dict(control.message_figures() or {})

    def given(self) -> list[tuple[str, str, str]]:
        """Return what operators commanded: the action, by whom, and why."""
        given = [command for record in self.records for command in record.observation.operator_commands]
        return [(str(each.action), each.by, each.why) for each in given]

    def level(self) -> float:
        """Return what the motor does in the newest cycle, from 0 to 1."""
        return float(self.records[-1].applied[0].level)
