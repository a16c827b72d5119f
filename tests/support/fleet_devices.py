"""Devices of a fleet in one process: the real receivers, behind one connection to a real broker."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import msgspec

from stadimeter.errors import ControlError
from stadimeter.messaging.mqtt import MqttOptions
from stadimeter.messaging.protocol import Received
from stadimeter.workbench.fleet.policy import FleetPolicy
from stadimeter.workbench.fleet.receiver import LocalRun, Receiver
from stadimeter.workbench.fleet.reports import Trial
from stadimeter.workbench.fleet.trial import try_out
from support.broker import HOST
from support.simulated_run import SIMULATED_BALL

OWN = SIMULATED_BALL + '[world]\n[rules.near]\nwhen = { below = "1 m" }\n'
RULES = '[rules.near]\nwhen = { below = "2 m" }\n'


class GivenRun(LocalRun):
    """A run that answers what it is told to, and notes by which text it was asked to go."""

    def __init__(self, configuration: Path) -> None:
        self.applied: list[str] = []
        self.is_there = True
        self.refuses = self.falls_ill = ""
        self.path = configuration

    def look(self) -> None:
        if not self.is_there:
            raise ControlError("no instance of stadimeter is running")

    def apply(self, *, restart: bool) -> None:
        self.look()
        text = self.path.read_text()
        if self.refuses and text != OWN:
            raise ControlError(self.refuses)
        self.applied.append(("restart: " if restart else "") + text)

    def await_health(self, running_sha256: str, *, restarted: bool) -> None:
        if self.falls_ill:
            raise ControlError(self.falls_ill)


class FleetOfReceivers:
    """Receivers of many devices, each with files of its own and a run whose answers are given.

    Attributes:
        silent: The devices that take nothing.
        trials: How often a configuration was tried.
    """

    def __init__(self, folder: Path, signers: Path, port: int, names: Iterable[str]) -> None:
        self.receivers: dict[str, Receiver] = {}
        self.runs: dict[str, GivenRun] = {}
        self.silent: set[str] = set()
        self.trials = 0
        self._port = port
        policy = FleetPolicy.model_validate({"allowed_signers": signers, "recording": folder / "none"})
        for name in names:
            path = folder / name.replace("/", "-") / "a.toml"
            path.parent.mkdir()
            path.write_text(OWN)
            self.runs[name] = GivenRun(path)
            try_this = partial(self._try, partial(try_out, path, policy))
            self.receivers[name] = Receiver(path, policy, f"stadimeter/{name}", try_this, self.runs[name])

    def _try(self, try_this: Callable[[str], Trial], text: str) -> Trial:
        self.trials += 1
        return try_this(text)

    @property
    def running(self) -> list[str]:
        """The devices of which a run has gone by another text than their own, or whose file holds one."""
        files = {name: path for name, run in self.runs.items() for path in [run.path]}
        return [name for name, path in files.items() if self.runs[name].applied or path.read_text() != OWN]

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Have them all at the broker, in a thread."""
        ending, ready = threading.Event(), threading.Event()
        thread = threading.Thread(target=self._serve, args=(ending, ready))
        thread.start()
        try:
            assert ready.wait(120.0)
            yield
        finally:
            ending.set()
            thread.join()

    def _serve(self, ending: threading.Event, ready: threading.Event) -> None:
        waiting: dict[str, bytes] = {}

        def take(message: Received) -> None:
            name = message.topic.removeprefix("stadimeter/").removesuffix("/desired")
            if message.payload and name in self.receivers:
                waiting[name] = message.payload

        options = MqttOptions(host=HOST, port=self._port, node="devices")
        filters = ("stadimeter/+/desired", "stadimeter/+/+/desired")
        with closing(options.subscribe(filters, take, 80_000)) as subscription:
            while subscription.trouble():
                subscription.serve(0.05)
            for name, receiver in self.receivers.items():
                subscription.publish(f"{receiver.device}/availability", "online", None)
                self._report(name, subscription.publish)
            subscription.serve(0.5)
            ready.set()
            while not ending.is_set():
                subscription.serve(0.05)
                for name in [*waiting]:
                    message = waiting.pop(name)
                    if name not in self.silent:
                        self.receivers[name].receive(message)
                        self._report(name, subscription.publish)
                        subscription.serve(0.001)

    def _report(self, name: str, publish: Callable[[str, str, int | None], None]) -> None:
        report = msgspec.json.encode(self.receivers[name].report()).decode()
        publish(f"stadimeter/{name}/configuration", report, None)
