"""The commands ``fleet receive`` and ``fleet arm``: the side of the device."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from stadimeter.cli.exits import ConfigArgument, configuration_path, plain_errors, read_option
from stadimeter.cli.fleet import broker_of
from stadimeter.cli.fleet_view import explained_lines
from stadimeter.config.units import parse_duration
from stadimeter.errors import StateError, reason_of
from stadimeter.messaging.protocol import Received, Subscribes

if TYPE_CHECKING:
    from stadimeter.workbench.fleet.receiver import Receiver

# What is longer than allowed is refused in words up to this length.
MAX_MESSAGE_BYTES = 80_000

PolicyFile = Annotated[
    Path | None,
    typer.Option("--policy", metavar="FILE", help="What a fleet may change; by default fleet.toml beside CONFIG."),
]


def receive(config: ConfigArgument = None, policy: PolicyFile = None) -> None:
    """Receive configurations for the run of this device: verify, try, and apply what its policy allows.

    Listens to the broker of CONFIG, and says there what this device runs and why. A run that refuses the new file, or
    is not well with it, gets the former one back. `fleet.toml` says whose signatures count and what may change.

    **Example**

    - `stadimeter fleet receive /etc/stadimeter/appliance.toml`

    **Exit code**: 0 ended by Ctrl+C; 2 the policy or the configuration is wrong, or nothing can be remembered.
    """
    from stadimeter.workbench.fleet.policy import POLICY, load_policy  # noqa: PLC0415 - not to show a fleet
    from stadimeter.workbench.fleet.receiver import Receiver  # noqa: PLC0415
    from stadimeter.workbench.fleet.trial import try_apart  # noqa: PLC0415

    with plain_errors(), suppress(KeyboardInterrupt):
        path = configuration_path(config)
        file = policy or path.parent / POLICY
        rules = load_policy(file)
        while True:  # anew with each other broker
            messenger = broker_of(path, {})
            receiver = Receiver(path, rules, messenger.base, partial(try_apart, path, file))
            receiver.recover()
            with ThreadPoolExecutor(1) as worker:
                _serve(receiver, messenger, path, worker)


def _serve(receiver: Receiver, messenger: Subscribes, path: Path, worker: ThreadPoolExecutor) -> None:
    """Hand on what comes, the newest first, and say what came of it, until the file names another broker."""
    from stadimeter.workbench.fleet.reports import DESIRED, REPORT  # noqa: PLC0415 - not to show a fleet

    newest: list[bytes] = []
    job: Future[None] | None = None
    told = ""

    def take(message: Received) -> None:
        newest[:] = [message.payload] if message.payload else newest

    typer.echo(f"{receiver.device} listens to {messenger.place} for configurations")
    with closing(messenger.subscribe((f"{receiver.device}/{DESIRED}",), take, MAX_MESSAGE_BYTES)) as subscription:
        while True:
            subscription.serve(1.0)
            is_ended = job is not None and job.done()
            if job is not None and is_ended:
                job.result()
                job = None
                typer.echo("\n".join(explained_lines(receiver.report())))
            if job is None and newest:
                job = worker.submit(receiver.receive, newest.pop())
            trouble = subscription.trouble()
            if (words := trouble or msgspec.json.encode(receiver.report()).decode()) != told:
                if trouble:
                    typer.echo(f"warning: {trouble}", err=True)
                else:
                    subscription.publish(f"{receiver.device}/{REPORT}", words, None)
                told = words
            if is_ended and broker_of(path, {}) != messenger:
                subscription.serve(1.0)
                return


def arm(
    config: ConfigArgument = None,
    policy: PolicyFile = None,
    for_: Annotated[str, typer.Option("--for", metavar="TIME", help="For how long.")] = "15 min",
) -> None:
    """Let one configuration of a fleet change how something moves: only here, on the device, and only for a while.

    Without it, whatever concerns a base, outputs, pins, limits or rules that move something is refused. It ends with
    the first such configuration that is applied, after the time, and when the computer restarts.

    **Example**

    - `sudo stadimeter fleet arm /etc/stadimeter/appliance.toml --for "15 min"`

    **Exit code**: 0 done; 2 the policy is wrong, or it cannot be noted.
    """
    from stadimeter.workbench.fleet.policy import POLICY, MotionPermit, load_policy  # noqa: PLC0415 - not to show a fleet

    with plain_errors():
        path = configuration_path(config)
        file = load_policy(policy or path.parent / POLICY).file_beside(path, "motion")
        try:
            MotionPermit(file).give(read_option(parse_duration, for_, "--for"))
        except OSError as error:
            raise StateError(f"{file} cannot be written: {reason_of(error)}") from error
    typer.echo(f"for {for_}, one configuration of a fleet may change how something moves here")
