"""The offers of a run beside its cycles: snapshots for terminal and page, and the requests of operators.

While there are viewers in other processes, a thread looks whether the loop has left a new frame, ten times a second at
most. It makes what is the same for all, such as the JPEG, and wakes those who watch; the thread of each adds the rest
and sends it. One still busy with the last one is passed over. So a slow reader gets fewer snapshots and every event,
and neither holds up the run nor keeps anything in memory.

The loop waits for its next frame at that moment, and has no use for the interpreter: what is made right after a cycle
costs it least.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct, field

import stadimeter
from stadimeter.app.control.messages import FrameArgs, Reply, SubscribeArgs, WorldArgs
from stadimeter.app.control.recording import LastRecording, RecordingOnRequest, recordings_folder
from stadimeter.app.control.reloading import Reloader, Restarter, build_parts
from stadimeter.app.control.requests import Act, Control, Take
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import RunHistory, Seen, newer
from stadimeter.app.live.pictures import Pictures, drawn
from stadimeter.app.live.snapshot import LiveFeed, RunSnapshot, events_data, frame_data, samples_data, shared_data
from stadimeter.app.service import is_service
from stadimeter.config.files import sha256_of
from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.alarms.state import Acknowledgement
from stadimeter.core.decide import State
from stadimeter.core.decision import Decision, Event, EventKind
from stadimeter.core.frame import Frame
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import ControlError

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import StagedWorld
    from stadimeter.app.live.history import RunHistory
    from stadimeter.app.loop import Loop
    from stadimeter.config.loader import Configuration


PERIOD_S = 0.1

# A frame that comes this much before it is time counts as in time: frames never come evenly.
EARLY_S = 0.015

# From then on it is looked for this often.
LOOK_EVERY_S = 0.003

# Without a new frame a snapshot is sent after this long: the age of the picture grows.
WITHOUT_FRAME_S = 0.3

SUBSCRIPTIONS_MAX = 16

# The first snapshot has this many events; a reader who was slow may get more later.
FIRST_EVENTS_MAX = 100

# Takes what makes the next message, and calls it in a thread of its own. It never waits.
Wake = Callable[[Callable[[], Reply]], None]


class _Moment(Struct, frozen=True, kw_only=True):
    """A snapshot, and what is the same of it for all who watch."""

    number: int
    snapshot: RunSnapshot
    shared: Mapping[str, Any]


class _Subscription(Struct, eq=False):
    """One who watches, and what they know already.

    Attributes:
        is_woken: Whether they were woken, and have not begun to make their message.
    """

    args: SubscribeArgs
    wake: Wake
    is_woken: bool = False
    woken_s: float = float("-inf")
    after_event: int = -1
    after_s: float = float("-inf")
    frame: Frame | None = None

    def is_due(self, now_s: float) -> bool:
        """Check whether it is time for their next snapshot."""
        return not self.is_woken and now_s - self.woken_s >= 1 / self.args.rate_hz - 2 * EARLY_S


class Subscriptions(Struct):
    """Those who watch a run from another process."""

    feed: LiveFeed
    _all: tuple[_Subscription, ...] = ()
    _thread: threading.Thread | None = None
    _told_s: float = float("-inf")
    _told: Seen | None = None
    _number: int = 0
    _moment: _Moment | None = None
    _pictures: Pictures = field(default_factory=Pictures)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def subscribe(self, args: SubscribeArgs, wake: Wake) -> Callable[[], None]:
        """Add a viewer; the returned function removes it.

        Raises:
            ControlError: One more watcher would cost the run too much.
        """
        subscription = _Subscription(args, wake)
        with self._lock:
            if len(self._all) >= SUBSCRIPTIONS_MAX:
                raise ControlError(f"{SUBSCRIPTIONS_MAX} subscriptions are the most that a run serves; end one first")
            self._all = (*self._all, subscription)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="subscriptions", daemon=True)
                self._thread.start()
        return lambda: self._end(subscription)

    def frame(self, args: FrameArgs) -> Reply:
        """Return the newest frame with what is known of it; an error if there is none."""
        seen = self.feed.history.seen
        if seen is None or seen.frame is None:
            return Reply(error="there is no picture yet")
        frame = seen.frame
        data: dict[str, Any] = {**(frame_data(seen, self.feed.unix_offset_s()) or {}), **_origin(frame)}
        if args.encoding == "raw":
            image = drawn(frame.image, seen.record, frame.width_px) if args.image == "drawn" else frame.image
            return Reply(data, attached=np.ascontiguousarray(image).data.cast("B"))
        with self._lock:
            jpeg = self._pictures.jpeg(seen, args.image, args.quality)
            self._keep_nothing_unwatched()
        return Reply(data, attached=jpeg)

    def _end(self, subscription: _Subscription) -> None:
        with self._lock:
            self._all = tuple(each for each in self._all if each is not subscription)
            self._keep_nothing_unwatched()

    def _keep_nothing_unwatched(self) -> None:
        if not self._all:
            self._pictures.forget()
            self._moment = self._told = None

    def _run(self) -> None:
        while True:
            self._wait_for_news()
            with self._lock:
                if not self._all:
                    self._thread = None
                    return
                self._number += 1
            due = [each for each in self._all if each.is_due(self._told_s)]
            with suppress(BaseException):  # each viewer gets the same defect as an answer, and this thread goes on
                self._prepare(due)
            for each in due:
                each.is_woken, each.woken_s = True, self._told_s
                each.wake(partial(self._message, each))

    def _prepare(self, due: Sequence[_Subscription]) -> None:
        """Make what they share, in this one thread: allocators keep large buffers for each thread that had some."""
        with self._lock:
            seen = self._newest().snapshot.seen if due else None
            for each in due:
                if seen is not None and seen.frame is not each.frame:
                    self._pictures.jpeg(seen, each.args.image, each.args.quality)

    def _wait_for_news(self) -> None:
        """Return when it is time for a snapshot: with a new frame if one comes, and no later if none does."""
        history, latest_s = self.feed.history, self._told_s + WITHOUT_FRAME_S
        time.sleep(max(0.0, self._told_s + PERIOD_S - EARLY_S - time.monotonic()))
        while history.seen is self._told and self._all and time.monotonic() < latest_s:
            time.sleep(LOOK_EVERY_S)
        self._told, self._told_s = history.seen, time.monotonic()

    def _message(self, to: _Subscription) -> Reply:
        """Return the newest snapshot for one viewer."""
        to.is_woken = False
        with self._lock:
            moment = self._newest()
            snapshot = moment.snapshot
            seen = snapshot.seen
            is_new = seen is not None and seen.frame is not to.frame
            jpeg = self._pictures.jpeg(seen, to.args.image, to.args.quality) if seen is not None and is_new else b""
        to.frame = seen.frame if seen is not None else None
        new = [each for each in snapshot.events if each.sequence > to.after_event]
        events = events_data(reversed(new[: FIRST_EVENTS_MAX if to.after_event < 0 else None]), self.feed.wall_clock())
        samples = {name: newer(found, to.after_s) for name, found in snapshot.samples.items()}
        to.after_event = max((each.sequence for each in new), default=to.after_event)
        to.after_s = max((found[-1].at_s for found in samples.values() if found), default=to.after_s)
        age_s = round(self.feed.cycle_age_s(), 3)
        news = {"cycle_age_s": age_s, "events": events, "samples": samples_data(samples)}
        return Reply({**moment.shared, **news}, attached=jpeg)

    def _newest(self) -> _Moment:
        """Return the snapshot that all get who were woken at the same time."""
        if self._moment is None or self._moment.number != self._number:
            snapshot, offset_s = self.feed.snapshot(), self.feed.unix_offset_s()
            shared = shared_data(snapshot, self._number, self.feed.clock.now_s(), offset_s)
            self._moment = _Moment(number=self._number, snapshot=snapshot, shared=shared)
        return self._moment


def _origin(frame: Frame) -> Mapping[str, object]:
    optics = frame.optics
    known = {name: getattr(optics, name) for name in optics.__struct_fields__} if optics is not None else None
    return {"subsampling": frame.subsampling, "source": frame.source, "optics": known}


# What a run says of itself that no view shows: a page hands snapshots on to people who may only watch.
_NOT_FOR_WATCHERS = ("pid", "recordings", "configuration_age_s")


def live_feed(loop: Loop) -> LiveFeed:
    """Return the view of a run for those who watch it."""
    parts = loop.parts
    told = {name: value for name, value in introduction(loop).items() if name not in _NOT_FOR_WATCHERS}
    fixed = told | {
        "title": parts.configuration.path.name,
        "started_unix_s": round(time.time(), 3),
        "colours": colours_of(parts.configuration),
    }
    return LiveFeed(parts.clock, loop.history, partial(_around, loop, fixed), Board(parts.configuration.path.parent))


def _around(loop: Loop, fixed: Mapping[str, object]) -> dict[str, Any]:
    """Return the parts that a run has beside its cycles, by the names of a snapshot. May be called from any thread."""
    configuration, world, recording = loop.parts.configuration, loop.parts.world, loop.services.recording
    detectors = loop.parts.cycle.perceiver.detectors
    state = world.state() if world is not None else None
    return {
        "plan": configuration.plan,
        "trouble": loop.trouble(),
        "messenger": loop.deliveries.link(),
        "messages": tuple(loop.deliveries.published),
        "narration": world.narration() if world is not None else "",
        "run": {**fixed, "digest": sha256_of(configuration.text), "world": state},
        "recording": recording.now() if recording is not None else None,
        "has_corners": {name: detector.target_shape.has_corners for name, detector in detectors.items()},
    }


@contextmanager
def attend_to_requests(loop: Loop, sources: Iterable[Take]) -> Iterator[None]:
    """Connect the requests of operators to a run that has not begun, while in the context."""
    services, configuration = loop.services, loop.parts.configuration
    restarter = Restarter(partial(build_parts, configuration.path))
    run = loop.parts, lambda: loop.state, services.tell, loop.deadline
    recordings = [recording := RecordingOnRequest(*run)]
    if (table := configuration.recording) is not None:
        recordings.append(LastRecording(*run, table.last))
    acts: dict[str, Act] = {
        "alarms": lambda _args, answer: _answer_alarms(loop.state, loop.history, answer),
        "restart": restarter.act,
        "record": recording.act,
    }
    if loop.parts.world is not None:
        acts["world"] = partial(_change_world, loop.parts.world, configuration.plan.targets)
    loop.listeners += recordings
    services.restarter, services.recording = restarter, recording
    services.control = Control(
        sources,
        Reloader(configuration),
        deliveries=loop.deliveries.figures,
        acts=acts,
        is_kept=lambda: services.memory.is_kept() if services.memory is not None else None,
    )
    try:
        yield
    finally:
        for each in recordings:
            each.close()


def _change_world(world: StagedWorld, targets: Collection[str], args: WorldArgs, answer: Answer) -> None:
    """Put a target somewhere in a simulated world or make something go wrong; answer with what is where then."""
    problem = _trouble_in_world(world, targets, args)
    answer(Reply(error=problem) if problem else Reply(dict(world.state())))


def _trouble_in_world(world: StagedWorld, targets: Collection[str], args: WorldArgs) -> str:
    """Do what is asked for; return why it cannot be done."""
    if args.target and args.target not in targets:
        return f"there is no target '{args.target}'; {did_you_mean_or_list(args.target, targets)}"
    if args.fault:
        known = world.state()["faults"]
        if args.fault not in known:
            return f"there is no fault '{args.fault}'; {did_you_mean_or_list(args.fault, known)}"
        world.toggle(args.fault)
    elif args.release:
        world.let_go()
    elif args.x_m is not None and args.y_m is not None:
        world.place_target(args.x_m, args.y_m)
    elif args.bearing_rad is not None and args.distance_m is not None:
        world.place_target(*world.in_world_m(args.bearing_rad, args.distance_m))
    else:
        return "a target is put at x_m and y_m, or at bearing_rad and distance_m; or name a fault, or say release"
    return ""


def _answer_alarms(state: State | None, history: RunHistory, answer: Answer) -> None:
    """Answer with every alarm, the one that was raised last first, and the newest events."""
    if state is None or history.record is None or state.now_s is None:
        answer(Reply(error="no cycle yet"))
        return
    decision, events = history.record.decision, tuple(history.events)
    unix_s = history.wall_clock(state.now_s, time.time())
    told = events_data(events, unix_s)
    answer(lambda: Reply({"alarms": _alarms(state, decision, events, unix_s), "events": told}))


def _alarms(
    state: State, decision: Decision, events: tuple[Event, ...], unix_s: Callable[[float], float]
) -> list[dict[str, Any]]:
    newest = {(event.source, event.kind): event.at_s for event in reversed(events)}
    alarms = [
        _alarm(rule, step, newest, unix_s) | {"reason": decision.reasons.get(rule.name, "")}
        for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)
        if isinstance(rule, AlarmRule) and isinstance(step, AlarmStep)
    ]
    return sorted(alarms, key=lambda alarm: -(alarm["raised_unix_s"] or 0.0))


def _alarm(
    rule: AlarmRule, step: AlarmStep, newest: Mapping[tuple[str, EventKind], float], unix_s: Callable[[float], float]
) -> dict[str, Any]:
    """Return an alarm as JSON has it.

    Args:
        newest: When each rule last had an event of each kind, of those that are remembered, on the run's clock.
    """

    def rounded(at_s: float | None) -> float | None:
        return None if at_s is None or math.isnan(at_s) else round(unix_s(at_s), 3)

    record = step.record
    acknowledged = record.acknowledgement or Acknowledgement(at_s=math.nan)
    raised_s, cleared_s = (newest.get((rule.name, kind)) for kind in (EventKind.RAISED, EventKind.CLEARED))
    if cleared_s is not None and raised_s is not None and cleared_s < raised_s:
        cleared_s = None
    over_s = record.leg.began_s if record.leg is not None and record.leg.on == "cleared" else None
    return {
        "rule": rule.name,
        "status": step.trace.status.value,
        "acknowledged": step.trace.acknowledged,
        "inhibits": step.trace.inhibits,
        "raised_unix_s": rounded(raised_s if record.raised_at_s is None else record.raised_at_s),
        "cleared_unix_s": rounded(over_s if cleared_s is None else cleared_s),
        "acknowledged_by": acknowledged.by,
        "acknowledged_unix_s": rounded(acknowledged.at_s),
        "why": acknowledged.why,
        "count": record.raises,
        "severity": rule.severity.value,
    }


# The facts that a run tells of itself to each client that connects --------------------------------


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


def colours_of(configuration: Configuration) -> dict[str, str]:
    """Return the targets that are found by a colour, each with the name of its table."""
    return {
        target: choice.name
        for choice in configuration.targets
        if getattr(choice.options, "hsv", None) is not None
        for target in choice.members or (choice.name,)
    }
