"""Puts together what people and programs may ask of a run, beside its rules."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from stadimeter.app.control.alarm_list import AlarmList
from stadimeter.app.control.recording import RecordingOnRequest
from stadimeter.app.control.reloading import Reloader
from stadimeter.app.control.requests import Act, Control, Requests
from stadimeter.app.control.restarting import Restarter, built
from stadimeter.app.control.staging import Stage
from stadimeter.app.live.snapshot_json import events_json
from stadimeter.app.live.watching import live_feed

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop


@contextmanager
def operated(loop: Loop, requests: Requests) -> Iterator[None]:
    """Let a run that has not begun attend to requests while in the context."""
    services, configuration = loop.services, loop.parts.configuration
    history = live_feed(loop).history
    alarms = AlarmList(lambda: tuple(history.events), events_json)
    restarter = Restarter(partial(built, configuration.path))
    recording = RecordingOnRequest(loop.parts, lambda: loop.state, services.tell, loop.deadline)
    acts: dict[str, Act] = {"alarms": alarms.act, "restart": restarter.act, "record": recording.act}
    if loop.parts.world is not None:
        acts["world"] = Stage(loop.parts.world, configuration.plan.targets).act
    loop.listeners.append(recording)
    services.alarms, services.restarter, services.recording = alarms, restarter, recording
    services.control = Control(
        requests,
        Reloader(configuration),
        deliveries=loop.deliveries.figures,
        acts=acts,
        is_kept=services.is_kept,
    )
    try:
        yield
    finally:
        recording.close()
