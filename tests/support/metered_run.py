"""A run that is made by hand, cycle by cycle, and can be asked for its metrics at a control socket."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.live.health import THERMAL, Board
from stadimeter.app.live.history import RunHistory
from stadimeter.app.live.metrics import metric_families
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.testing.rig import ManualClock
from support.cycle_records import cycle_record

# Under-voltage and throttled, now and since the start, as the firmware says it.
THROTTLED_BITS = "50005"


class MeteredRun:
    """A run on a board that is hot, whose supply is low, with a broker that is away."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock()
        self.asked = 0
        self.deliveries = [{"to": "messenger", "waiting": 3, "given_up": 1}]
        self.history = RunHistory(real_time_s=self.clock.now_s)
        around = {
            "messenger": {"trouble": "it does not answer", "topics": ()},
            "run": {"title": "hall.toml", "version": "1", "started_unix_s": 9.5},
        }
        board = Board(folder, root=_raspberry_pi(folder / "root"))
        self.feed = LiveFeed(self.clock, self.history, lambda: around, board)
        self.control = ControlSocket(folder / "run.sock", dict, metrics=self.metrics)

    def metrics(self) -> object:
        self.asked += 1
        return metric_families(self.feed, lambda: self.deliveries)

    def cycle(self, **changes: Any) -> None:
        """Take in a cycle a tenth of a second later."""
        self.clock.advance_s(0.1)
        self.history.add(cycle_record(self.clock.now_s(), **changes))


@contextmanager
def metered_run(folder: Path) -> Iterator[MeteredRun]:
    """Have such a run listen."""
    run = MeteredRun(folder)
    run.control.open()
    try:
        yield run
    finally:
        run.control.close()


def _raspberry_pi(root: Path) -> Path:
    files = {
        THERMAL: "81500\n",
        "sys/bus/platform/drivers/raspberrypi-firmware/soc/get_throttled": THROTTLED_BITS,
        "proc/self/statm": "9000 5000",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root
