"""What a run offers beside its cycles: one feed of snapshots for terminal and page, and the requests of operators."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import stadimeter
from stadimeter.app.control.alarm_list import AlarmList
from stadimeter.app.control.recording import RecordingOnRequest, recordings_folder
from stadimeter.app.control.reloading import Reloader
from stadimeter.app.control.requests import Act, Control, Requests
from stadimeter.app.control.restarting import Restarter, built
from stadimeter.app.control.staging import Stage
from stadimeter.app.live.health import CONNECTED, Board
from stadimeter.app.live.snapshot import LiveFeed, Surroundings
from stadimeter.app.live.snapshot_json import events_json
from stadimeter.app.recordings.recorded_configuration import sha256_of
from stadimeter.app.service import is_service

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop


def live_feed(loop: Loop) -> LiveFeed:
    """Return the feed of a run that has not begun yet; the first call lets it listen to the loop."""
    for listener in loop.listeners:
        if isinstance(listener, LiveFeed):
            return listener
    configuration = loop.parts.configuration
    folder = configuration.path.parent
    feed = LiveFeed(loop.parts.clock, _surroundings(loop), Board(folder))
    loop.listeners.append(feed)
    return feed


# What a run says of itself that no view shows: a page hands snapshots on to people who may only watch.
_NOT_FOR_WATCHERS = ("pid", "recordings", "configuration_age_s")


def introduction(loop: Loop) -> dict[str, object]:
    """Return the facts about a run that each client gets when it connects."""
    configuration = loop.parts.configuration
    return {
        "configuration": str(configuration.path.resolve()),
        "pid": os.getpid(),
        "version": stadimeter.__version__,
        "digest": sha256_of(configuration.text),
        "configuration_age_s": round(time.monotonic() - loop.configured_at_s, 1),
        "is_service": is_service(),
        "recordings": str(recordings_folder(configuration.path)),
        "world": loop.parts.world is not None,
    }


def _surroundings(loop: Loop) -> Surroundings:
    parts = loop.parts
    told = {name: value for name, value in introduction(loop).items() if name not in _NOT_FOR_WATCHERS}
    fixed = told | {
        "title": parts.configuration.path.name,
        "started_unix_s": round(time.time(), 3),
    }
    detectors = parts.cycle.perceiver.detectors

    def run() -> Mapping[str, object]:
        world = parts.world.state() if parts.world is not None else None
        return fixed | {"digest": sha256_of(parts.configuration.text), "world": world}

    def broker() -> str:
        return "" if parts.messenger is None else parts.messenger.trouble() or CONNECTED

    def recording() -> Mapping[str, object] | None:
        on_request = loop.services.recording
        return on_request.now() if on_request is not None else None

    return Surroundings(
        recording=recording,
        plan=lambda: parts.configuration.plan,
        trouble=loop.trouble,
        broker=broker,
        messages=lambda: tuple(loop.published),
        narration=parts.world.narration if parts.world is not None else str,
        run=run,
        has_corners={name: detector.target_shape.has_corners for name, detector in detectors.items()},
    )


@contextmanager
def attend_to_requests(loop: Loop, requests: Requests) -> Iterator[None]:
    """Connect the requests of operators to a run that has not begun, while in the context."""
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
        is_kept=lambda: services.memory.is_kept() if services.memory is not None else None,
    )
    try:
        yield
    finally:
        recording.close()
