"""Snapshots of a run for those who watch it, in the terminal or from another process.

The loop adds its cycles, which takes microseconds. Everything else is done in the threads of those who watch: when it
is time for a snapshot they are woken, once for each, and whoever is still busy with the last one is passed over. So a
slow reader gets fewer snapshots and neither holds up the run nor keeps anything in memory.

They are woken by a new frame, right after the cycle that dealt with it: then the loop waits for the next frame, and
has no use for the interpreter.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from stadimeter.app.control.messages import FrameArgs, Reply, SubscribeArgs
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import WINDOW_S, RunHistory
from stadimeter.app.live.pictures import Pictures, drawn
from stadimeter.app.live.snapshot import Snapshot, Surroundings, snapshot_of
from stadimeter.app.live.snapshot_json import events_json, frame_data, samples_json, shared_json
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import ControlError

RATE_MAX_HZ = 10.0

EARLY_S = 0.02
"""A frame that comes this much before it is time counts as in time: frames never come evenly."""

WITHOUT_FRAME_S = 0.3
"""Without a new frame a snapshot is told after this long: time passes, and the picture grows old."""

SUBSCRIPTIONS_MAX = 16

FIRST_EVENTS_MAX = 100
"""The first snapshot has this many events; a reader who was slow may get more later."""

Wake = Callable[[Callable[[], Reply]], None]
"""Takes what makes the next answer, and calls it in a thread of its own. It never waits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """A snapshot, and what is the same of it for all who watch."""

    number: int
    snapshot: Snapshot
    shared: str
    unix_offset_s: float


@dataclass(slots=True, eq=False)
class _Subscription:
    """One who watches."""

    args: SubscribeArgs
    wake: Wake
    is_woken: bool = False
    told_s: float = float("-inf")
    after_event: int = -1
    since_s: float = float("-inf")
    frame: Frame | None = None


@dataclass(slots=True)
class LiveFeed:
    """Snapshots of a run.

    Attributes:
        clock: The run's clock.
        real_time_s: A monotonic clock of real time: simulated time would wake too often, or too seldom.
    """

    clock: Clock
    surroundings: Surroundings = field(default_factory=Surroundings)
    board: Board = field(default_factory=Board)
    real_time_s: Callable[[], float] = time.monotonic
    unix_time_s: Callable[[], float] = time.time
    history: RunHistory = field(default_factory=RunHistory)
    _subscriptions: tuple[_Subscription, ...] = ()
    _woken_s: float = float("-inf")
    _number: int = 0
    _moment: _Moment | None = None
    _pictures: Pictures = field(default_factory=Pictures)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle, in the loop's thread, and wake those who wait for it."""
        self.history.add(record, frame)
        if not self._subscriptions:
            return
        now_s = self.real_time_s()
        is_due_s = 1 / RATE_MAX_HZ - EARLY_S if frame is not None else WITHOUT_FRAME_S
        if now_s - self._woken_s < is_due_s:
            return
        self._woken_s = max(self._woken_s + 1 / RATE_MAX_HZ, now_s - EARLY_S)
        self._number += 1
        for each in self._subscriptions:
            if not each.is_woken and now_s - each.told_s >= 1 / each.args.rate_hz - EARLY_S:
                each.is_woken, each.told_s = True, now_s
                each.wake(partial(self._message, each))

    def snapshot(self, window_s: float = WINDOW_S) -> Snapshot:
        """Return what there is to see now, with the distances of this long."""
        record = self.history.record
        since_s = record.observation.now_s - window_s if record is not None else 0.0
        return snapshot_of(self.history, self.surroundings, self.board, since_s)

    def subscribe(self, args: SubscribeArgs, wake: Wake) -> Callable[[], None]:
        """Begin to tell somebody about the run; the returned function ends it.

        Raises:
            ControlError: So many watch already that a further one would cost the run too much.
        """
        subscription = _Subscription(args, wake)
        with self._lock:
            if len(self._subscriptions) >= SUBSCRIPTIONS_MAX:
                raise ControlError(f"{SUBSCRIPTIONS_MAX} subscriptions are the most that a run serves; end one first")
            self._subscriptions = (*self._subscriptions, subscription)
        return lambda: self._end(subscription)

    def frame(self, args: FrameArgs) -> Reply:
        """Return the newest frame with what is known of it; an error if there is none."""
        with self._lock:
            seen = self.history.seen
            if seen is None or seen.frame is None:
                return Reply(error="there is no picture yet")
            data: dict[str, Any] = {**(frame_data(seen, self._unix_offset_s()) or {}), **_origin(seen.frame)}
            if args.encoding == "raw":
                image = seen.frame.image
                image = drawn(image, seen.record, seen.frame.width_px) if args.image == "drawn" else image
                return Reply(data, attached=image.tobytes())
            jpeg = self._pictures.jpeg(seen, args.image, args.quality)
            if not self._subscriptions:
                self._pictures.forget()
            return Reply(data, attached=jpeg)

    def _end(self, subscription: _Subscription) -> None:
        with self._lock:
            self._subscriptions = tuple(each for each in self._subscriptions if each is not subscription)
            if not self._subscriptions:
                self._pictures.forget()
                self._moment = None

    def _message(self, to: _Subscription) -> Reply:
        """Return the newest snapshot as it is told to one who watches."""
        to.is_woken = False
        with self._lock:
            moment = self._newest()
            snapshot = moment.snapshot
            first = to.after_event < 0
            news = [each for each in snapshot.events if each.sequence > to.after_event]
            events = events_json(reversed(news[: FIRST_EVENTS_MAX if first else None]), moment.unix_offset_s)
            samples = samples_json({name: found.since(to.since_s) for name, found in snapshot.samples.items()})
            seen = snapshot.seen
            is_new = seen is not None and seen.frame is not to.frame
            jpeg = self._pictures.jpeg(seen, to.args.image, to.args.quality) if seen is not None and is_new else b""
            to.frame = seen.frame if seen is not None else None
            to.after_event = max((each.sequence for each in news), default=to.after_event)
            newest_s = [found[-1].at_s for found in snapshot.samples.values() if found]
            to.since_s = max(newest_s, default=to.since_s) + 1e-6
        return Reply(json=f'{moment.shared},"events":{events},"samples":{samples}}}', attached=jpeg)

    def _newest(self) -> _Moment:
        """Return the snapshot that all get who were woken at the same time."""
        if self._moment is None or self._moment.number != self._number:
            snapshot, offset_s = self.snapshot(), self._unix_offset_s()
            now_s = self.clock.now_s()
            shared = shared_json(snapshot, self._number, now_s, now_s + offset_s)
            self._moment = _Moment(number=self._number, snapshot=snapshot, shared=shared, unix_offset_s=offset_s)
        return self._moment

    def _unix_offset_s(self) -> float:
        return self.unix_time_s() - self.clock.now_s()


def _origin(frame: Frame) -> Mapping[str, object]:
    optics = frame.optics
    known = {name: getattr(optics, name) for name in optics.__slots__} if optics is not None else None
    return {"subsampling": frame.subsampling, "source": frame.source, "optics": known}
