"""Snapshots of a run for those who watch it from another process.

While there are viewers, a thread looks whether the loop has left a new frame, ten times a second at most. It makes what
is the same for all, such as the JPEG, and wakes those who watch; the thread of each adds the rest and sends it. One
still busy with the last one is passed over. So a slow reader gets fewer snapshots and every event, and neither holds up
the run nor keeps anything in memory.

The loop waits for its next frame at that moment, and has no use for the interpreter: what is made right after a cycle
costs it least.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from stadimeter.app.control.messages import FrameArgs, Reply, SubscribeArgs
from stadimeter.app.live.history import Seen
from stadimeter.app.live.pictures import Pictures, drawn
from stadimeter.app.live.snapshot import LiveFeed, RunSnapshot
from stadimeter.app.live.snapshot_json import ReasonsInTurn, events_json, frame_data, samples_json, shared_json
from stadimeter.core.frame import Frame
from stadimeter.errors import ControlError

PERIOD_S = 0.1

# A frame that comes this much before it is time counts as in time: frames never come evenly.
EARLY_S = 0.015

# A frame is looked for this long after it is expected, so as not to take the interpreter from the loop.
AFTER_S = 0.0015

# From then on it is looked for this often.
LOOK_EVERY_S = 0.003

# Without a new frame a snapshot is sent after this long: the age of the picture grows.
WITHOUT_FRAME_S = 0.3

SUBSCRIPTIONS_MAX = 16

# The first snapshot has this many events; a reader who was slow may get more later.
FIRST_EVENTS_MAX = 100

# Takes what makes the next message, and calls it in a thread of its own. It never waits.
Wake = Callable[[Callable[[], Reply]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """A snapshot, and what is the same of it for all who watch."""

    number: int
    snapshot: RunSnapshot
    shared: str
    unix_offset_s: float


@dataclass(slots=True, eq=False)
class _Subscription:
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
        """Return whether it is time for their next snapshot."""
        return not self.is_woken and now_s - self.woken_s >= 1 / self.args.rate_hz - 2 * EARLY_S


@dataclass(slots=True)
class Subscriptions:
    """Those who watch a run from another process."""

    feed: LiveFeed
    _all: tuple[_Subscription, ...] = ()
    _thread: threading.Thread | None = None
    _told_s: float = float("-inf")
    _told: Seen | None = None
    _number: int = 0
    _moment: _Moment | None = None
    _reasons: ReasonsInTurn = field(default_factory=ReasonsInTurn)
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
        due_s = self._after_frame_s(self._told_s + PERIOD_S - EARLY_S)
        time.sleep(max(0.0, min(due_s, latest_s) - time.monotonic()))
        while history.seen is self._told and self._all and time.monotonic() < latest_s:
            time.sleep(LOOK_EVERY_S)
        self._told, self._told_s = history.seen, time.monotonic()

    def _after_frame_s(self, due_s: float) -> float:
        """Return when the loop will be done with the first frame after a time, if frames go on as they came."""
        rate_hz, last_s = self.feed.history.frame_rate_hz, self.feed.frame_at_s
        if not rate_hz:
            return due_s
        return last_s + math.ceil(max(0.0, due_s - last_s) * rate_hz) / rate_hz + AFTER_S

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
        events = events_json(reversed(new[: FIRST_EVENTS_MAX if to.after_event < 0 else None]), moment.unix_offset_s)
        samples = {name: found.after(to.after_s) for name, found in snapshot.samples.items()}
        to.after_event = max((each.sequence for each in new), default=to.after_event)
        to.after_s = max((found[-1].at_s for found in samples.values() if found), default=to.after_s)
        age = f'"cycle_age_s":{self.feed.cycle_age_s():.3f}'
        news = f'"events":{events},"samples":{samples_json(samples)}'
        return Reply(json=f"{moment.shared},{age},{news}}}", attached=jpeg)

    def _newest(self) -> _Moment:
        """Return the snapshot that all get who were woken at the same time."""
        if self._moment is None or self._moment.number != self._number:
            snapshot, offset_s = self.feed.snapshot(), self.feed.unix_offset_s()
            shared = shared_json(snapshot, self._number, self.feed.clock.now_s(), offset_s, self._reasons)
            self._moment = _Moment(number=self._number, snapshot=snapshot, shared=shared, unix_offset_s=offset_s)
        return self._moment


def _origin(frame: Frame) -> Mapping[str, object]:
    optics = frame.optics
    known = {name: getattr(optics, name) for name in optics.__slots__} if optics is not None else None
    return {"subsampling": frame.subsampling, "source": frame.source, "optics": known}
