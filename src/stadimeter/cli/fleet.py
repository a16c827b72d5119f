"""The command ``fleet``: every device at a broker, and one list of standing alarms."""

from __future__ import annotations

import json
import math
import sys
import time
import uuid
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Console
from rich.live import Live

from stadimeter.cli.exits import NOT_FOUND, ConfigArgument, configuration_path, plain_errors, read_option
from stadimeter.cli.fleet_view import FleetScreen
from stadimeter.cli.operate import ByOption, JsonOption, print_answer, who
from stadimeter.config.loader import load_messenger_choice
from stadimeter.config.units import parse_duration
from stadimeter.core.words import one_line
from stadimeter.errors import ConfigError, ControlError, Problem
from stadimeter.messaging.protocol import Received, Subscribes
from stadimeter.workbench.fleet import Fleet, fleet_record, troubles

REFRESH_S = 0.5
CONNECT_S = 5.0

Host = Annotated[str | None, typer.Option("--host", metavar="HOST", help="The broker, instead of a configuration's.")]
Port = Annotated[int | None, typer.Option("--port", help="Its port.")]
Username = Annotated[str | None, typer.Option("--username", metavar="NAME", help="The name to log in with.")]
PasswordFile = Annotated[
    Path | None, typer.Option("--password-file", metavar="FILE", help="A file with the password on its first line.")
]
Tls = Annotated[bool, typer.Option("--tls", help="Encrypt, and check the broker's certificate.")]
CaFile = Annotated[Path | None, typer.Option("--ca-file", metavar="FILE", help="The authority of that certificate.")]
Below = Annotated[
    str | None, typer.Option("--below", metavar="TOPIC", help="What the topics of the devices begin with: stadimeter.")
]
Check = Annotated[bool, typer.Option("--check", help="Print what is wrong, and end with an exit code.")]
Acknowledge = Annotated[
    str | None, typer.Option("--acknowledge", metavar="NODE/RULE", help="Acknowledge an alarm of a device.")
]
Wait = Annotated[
    str | None, typer.Option("--wait", metavar="TIME", help='How long to listen first, such as "20 s"; by default 6 s.')
]


def fleet(
    config: ConfigArgument = None,
    host: Host = None,
    port: Port = None,
    username: Username = None,
    password_file: PasswordFile = None,
    tls: Tls = False,
    ca_file: CaFile = None,
    below: Below = None,
    wait: Wait = None,
    check: Check = False,
    acknowledge: Acknowledge = None,
    by: ByOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show every device at a broker, and one list of standing alarms.

    Listens to the broker of a configuration, or of `--host`. Figures are grey once they are older than 15 s, and when
    the device or the connection is gone. Ctrl+C ends it. Where there is no terminal, the picture is printed once.

    **Examples**

    - `stadimeter fleet config/appliance.toml`

    - `stadimeter fleet --host broker.local --username fleet --password-file password.txt --tls`

    - `stadimeter fleet config/appliance.toml --check --wait "20 s"`

    - `stadimeter fleet config/appliance.toml --acknowledge garage/too-close`

    **Exit code**: 0 done; with --check all are online and no alarm of severity alarm or safety stands; 1 with --check
    something is wrong, with --acknowledge the device refused; 2 the broker or the device does not answer.
    """
    with plain_errors():
        options = {"host": host, "port": port, "username": username, "tls": tls or None}
        options |= {"password_file": _absolute(password_file), "ca_file": _absolute(ca_file)}
        messenger = broker_of(config if host else configuration_path(config), options)
        root = below or ("stadimeter" if config is None and host else messenger.base.partition("/")[0])
        wait_s = None if wait is None else read_option(parse_duration, wait, "--wait")
        if acknowledge is not None:
            _acknowledge(messenger, f"{root}/{acknowledge}", who(by), wait_s or 10.0, as_json=as_json)
            return
        with closing(FleetConnection(messenger, root)) as listener:
            if as_json or check or not sys.stdout.isatty():
                listener.listen(6.0 if wait_s is None else wait_s)
                _print_once(listener, check=check, as_json=as_json)
            else:
                listener.show(math.inf if wait_s is None else wait_s)


class FleetConnection:
    """A connection, and the fleet that is made from what it brings."""

    def __init__(self, messenger: Subscribes, root: str) -> None:
        self.fleet = Fleet(root)
        self.place = messenger.place
        self.subscription = messenger.subscribe(self.fleet.filters, self._take)

    def close(self) -> None:
        """Disconnect."""
        self.subscription.close()

    def _take(self, message: Received) -> None:
        self.fleet.take(message, time.monotonic())

    def listen(self, seconds: float) -> None:
        """Listen for that long once there is a connection, or until Ctrl+C.

        Raises:
            ControlError: There is none in time, or at the end.
        """
        connected_until_s = time.monotonic() + max(seconds, CONNECT_S)
        with suppress(KeyboardInterrupt):
            while self.subscription.trouble() and time.monotonic() < connected_until_s:
                self.subscription.serve(0.05)
            until_s = time.monotonic() + (0.0 if self.subscription.trouble() else seconds)
            while (left_s := until_s - time.monotonic()) > 0:
                self.subscription.serve(left_s)
        if trouble := self.subscription.trouble():
            raise ControlError(trouble)

    def screen(self) -> FleetScreen:
        """Return the fleet as it is now."""
        now_s = time.monotonic()
        return FleetScreen(self.fleet, self.place, self.subscription.trouble(), now_s)

    def show(self, seconds: float) -> None:
        """Show the fleet on the whole terminal until Ctrl+C."""
        until_s = time.monotonic() + seconds
        with suppress(KeyboardInterrupt), Live(screen=True, auto_refresh=False) as live:
            while time.monotonic() < until_s:
                live.update(self.screen(), refresh=True)
                self.subscription.serve(REFRESH_S)


class _Answer(msgspec.Struct, frozen=True):
    """The answer of a device to a request."""

    status: str
    transaction: str
    data: Any = None
    error: str | None = None


def _acknowledge(messenger: Subscribes, alarm: str, by: str, wait_s: float, *, as_json: bool) -> None:
    base, _, rule = alarm.rpartition("/")
    if not rule or not base.partition("/")[2] or set(alarm) & set("+#"):
        raise ConfigError([Problem(f"{alarm!r} is no NODE/RULE, such as garage/too-close", key="--acknowledge")])
    request = {"rule": rule, "transaction": uuid.uuid4().hex, "by": by}
    answers: list[_Answer] = []

    def take(message: Received) -> None:
        with suppress(ValueError, RecursionError):  # another's answer, or nonsense
            answer = msgspec.json.decode(message.payload, type=_Answer)
            if answer.transaction == request["transaction"]:
                answers.append(answer)

    until_s, is_sent = time.monotonic() + wait_s, False
    with closing(messenger.subscribe((f"{base}/response/acknowledge",), take)) as subscription:
        while not answers and time.monotonic() < until_s:
            subscription.serve(0.1)
            if not is_sent and not subscription.trouble():
                subscription.publish(f"{base}/request/acknowledge", json.dumps(request), math.ceil(wait_s))
                is_sent = True
        trouble = subscription.trouble()
    if not answers:
        late = f"{base} did not answer within {wait_s:g} s; is it online, and does its program take acknowledgements?"
        raise ControlError(trouble or late)
    if answers[0].status != "ok":
        typer.echo(f"error: {one_line(answers[0].error or 'refused without a reason')}", err=True)
        raise typer.Exit(NOT_FOUND)
    print_answer(msgspec.to_builtins(answers[0]), f"acknowledged: {one_line(alarm)}", as_json=as_json)


def _print_once(listener: FleetConnection, *, check: bool, as_json: bool) -> None:
    """Print the fleet as it is now; with ``check`` only what is wrong in it."""
    now_s = time.monotonic()
    found = troubles(listener.fleet, now_s)
    if as_json:
        record = {"broker": listener.place, **fleet_record(listener.fleet, now_s), "troubles": found}
        typer.echo(json.dumps(record, ensure_ascii=False))
    elif check:
        typer.echo("\n".join(found) or f"{len(listener.fleet.devices)} devices are online, and no serious alarm stands")
    else:
        console = Console(highlight=False, soft_wrap=True)
        for line in listener.screen().lines(console.width, sys.maxsize):
            console.print(line)
    if check and found:
        raise typer.Exit(NOT_FOUND)


def _absolute(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())


def broker_of(config: Path | None, options: Mapping[str, object]) -> Subscribes:
    """Return the messenger of a configuration, with which a broker can be listened to; else raise ConfigError."""
    messenger = load_messenger_choice(config, {key: value for key, value in options.items() if value is not None})
    if not isinstance(messenger.options, Subscribes):
        raise ConfigError(f"{config}: there is no broker to listen to: its messenger is {messenger.driver!r}")
    return messenger.options
