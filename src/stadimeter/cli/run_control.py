"""Services of a run that are dear to load: the alarm store, and the control socket with live watching."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stadimeter.app.control.requests import Take
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.persistence.resumption import clock_name, moment
from stadimeter.app.persistence.state_writer import StateWriter
from stadimeter.app.places import make_folder, runtime_folder, socket_path, state_file
from stadimeter.app.watching import Subscriptions, attend_to_requests, introduction, live_feed
from stadimeter.errors import ControlError
from stadimeter.messaging.protocol import TakesRequests

if TYPE_CHECKING:
    from stadimeter.app.control.mqtt_requests import MqttRequests
    from stadimeter.app.live.snapshot import LiveFeed
    from stadimeter.app.loop import Loop


def open_alarm_store(loop: Loop, named: Path | None, is_right: Callable[[], bool]) -> None:
    """Store alarms across restarts, in the named file, or in the default one of a live camera."""
    configuration = loop.parts.configuration
    usual = state_file(configuration.path) if loop.parts.is_live else None
    path = named or usual
    if path is None:
        return
    from stadimeter.app.persistence.alarm_store import AlarmStore  # noqa: PLC0415 - needs SQLite, which a system may lack

    clock = clock_name(is_live=loop.parts.is_live)
    store = AlarmStore(path, is_named=named is not None)
    if named is not None:
        store.check()  # a wrong file that was named is reported before anything moves
    loop.services.memory = StateWriter(store, partial(moment, clock, is_right=is_right), loop.deliveries)


def _metrics(feed: LiveFeed, deliveries: Callable[[], list[dict[str, Any]]]) -> object:
    from stadimeter.app.live.metrics import metric_families  # noqa: PLC0415 - few runs are asked for them

    return metric_families(feed, deliveries)


def open_control_socket(loop: Loop, socket: Path | None, closing: ExitStack) -> None:
    """Listen for operator commands. Without a socket a run goes on with a warning, unless the socket was named."""
    configuration = loop.parts.configuration
    feed = live_feed(loop)
    watched = Subscriptions(feed)
    sources: list[Take] = []
    try:
        path = socket or socket_path(configuration.path, make_folder(runtime_folder()))
        metrics = partial(_metrics, feed, loop.deliveries.figures)
        listener = ControlSocket(path, partial(introduction, loop), watched=watched, metrics=metrics)
        closing.callback(listener.close)
        listener.open()
    except ControlError as error:
        if socket is not None:
            raise
        loop.services.tell(f"warning: {error}; this run takes no operator commands of this computer")
    else:
        sources.append(listener.take)
    remote = _listen_to_messages(loop, watched)
    if remote is not None:
        sources.append(remote.take)
    if sources:
        closing.enter_context(attend_to_requests(loop, sources))
    if remote is not None and (control := loop.services.control) is not None:
        control.message_figures = remote.figures


def _listen_to_messages(loop: Loop, watched: Subscriptions) -> MqttRequests | None:
    """Take the requests of other programs, if the messenger can and may; return where they come from."""
    messenger: object = loop.parts.messenger
    if not isinstance(messenger, TakesRequests) or messenger.commands == "off":
        return None
    from stadimeter.app.control.mqtt_requests import MqttRequests  # noqa: PLC0415 - many runs have no messenger

    remote = MqttRequests(messenger, watched.frame, loop.services.tell)
    remote.open()
    return remote
