"""Watches whether the camera of a run is still where it was: once a minute, and after each gap of the camera.

The loop hands over two of its pictures and goes on; a thread of low priority compares them with the saved view.
What it finds is there from the next cycle on, and stays until a person confirms it: then the present view is saved in
place of the former one.
"""

from __future__ import annotations

import math
import os
import threading
from contextlib import suppress
from queue import SimpleQueue

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.mounting_file import (
    APART_S,
    MOMENTS,
    PICTURES,
    MountingReference,
    judge_by,
    load_reference,
    make_reference,
    save_reference,
)
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.core.mounting import MOUNTING, Mounting, MountingStatus
from stadimeter.errors import StadimeterError, StateError
from stadimeter.perception.background import look_at
from stadimeter.perception.mounting import Judgement

EVERY_S = 60.0

# A camera that gave nothing for this long may have been unplugged, and touched.
GAP_S = 2.0

# How low the priority of the thread is: it gets a tenth of the time of the loop where both want all.
NICE = 10


class _MountingWork(Struct, eq=False):
    """Pictures to look at, as they come; those after a confirmation become the saved view."""

    is_confirmed: bool = False
    frames: list[Frame] = field(default_factory=list)
    hidden: list[NDArray[np.float64]] = field(default_factory=list)


class MountingWatch:
    """A listener of the loop that knows how the mounting is.

    Args:
        reference: The view that was saved.

    Attributes:
        mounting: What the newest check says.
    """

    def __init__(self, configuration: Configuration, lens: CameraModel, reference: MountingReference) -> None:
        self.mounting = Mounting(status=MountingStatus.NOT_JUDGED, reason="not looked at yet")
        self._configuration, self._lens = configuration, lens
        self._reference, self._judge = reference, judge_by(reference, configuration, lens)
        self._due_s = self._last_s = -math.inf
        self._next = _MountingWork()
        self._in_hand: _MountingWork | None = None
        self._works: SimpleQueue[_MountingWork | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="mounting", daemon=True)

    def start(self) -> None:
        """Begin to look at pictures."""
        self._thread.start()

    def close(self) -> None:
        """Look at no more pictures."""
        self._works.put(None)

    def why_not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in words; empty if it may."""
        is_stopped = self.mounting.is_unconfirmed and self._configuration.mounting.when_moved == "stop"
        return f"the mounting is unconfirmed: {self.mounting.reason}" if is_stopped else ""

    def trouble(self) -> str:
        """Return that distances are unconfirmed, in words; empty if they are not."""
        if not self.mounting.is_unconfirmed:
            return ""
        return (
            f"distances are unconfirmed, the camera is not mounted as it was saved: {self.mounting.reason}; "
            "put it right, or `stadimeter mounting confirm`"
        )

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle. Costs nothing but once a minute, and then a few references to pictures."""
        if record.mark and _is_confirmed(record):
            self.mounting, self._in_hand = Mounting(), None  # what is in hand shows what was confirmed
            self._begin(_MountingWork(is_confirmed=True))
        if frame is None:
            return
        now_s, work = frame.captured_at_s, self._next
        if now_s - self._last_s > GAP_S:
            work = self._begin(_MountingWork(is_confirmed=work.is_confirmed))
        self._last_s = now_s
        is_too_soon = work.frames and now_s - work.frames[-1].captured_at_s < APART_S
        if self._in_hand is not None or now_s < self._due_s or is_too_soon:
            return
        work.frames.append(frame)
        work.hidden += [each.outline_px for each in record.detections if len(each.outline_px)]
        if len(work.frames) >= (PICTURES * MOMENTS if work.is_confirmed else PICTURES):
            self._in_hand = work
            self._works.put(work)
            self._begin(_MountingWork(), now_s + EVERY_S)

    def _begin(self, work: _MountingWork, due_s: float = -math.inf) -> _MountingWork:
        self._next, self._due_s = work, due_s
        return work

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (work := self._works.get()) is not None:
            try:
                self._attend(work)
            except Exception as error:  # noqa: BLE001 - a defect here must not end the watch, nor stay unsaid
                self._say(work, MountingStatus.NOT_JUDGED, f"the check failed: {error}")
            finally:
                if self._in_hand is work:
                    self._in_hand = None

    def _attend(self, work: _MountingWork) -> None:
        saved = load_reference(self._configuration.path)
        if saved is not None and saved.saved_unix_s != self._reference.saved_unix_s:  # by the command, meanwhile
            self._use(saved)
            self.mounting = Mounting()
        lens = self._lens.for_frame(work.frames[0])
        if work.is_confirmed:
            self._save_anew(work)
        elif why := self._reference.why_not_for(work.frames[0], lens):
            self._say(work, MountingStatus.NOT_JUDGED, why)
        else:
            self._take_in(work, self._judge.judge(look_at([each.image for each in work.frames], lens, work.hidden)))

    def _take_in(self, work: _MountingWork, judgement: Judgement) -> None:
        otherwise = MountingStatus.NOT_JUDGED if judgement.not_judged else MountingStatus.AS_SAVED
        status = MountingStatus.UNCONFIRMED if judgement.settled else otherwise
        self._say(work, status, "; ".join(judgement.settled.values()) or judgement.not_judged)
        if judgement.has_learnt:
            self._reference = replace(self._reference, views=list(self._judge.views))
            with suppress(StadimeterError):  # it is learnt again after a restart
                save_reference(self._configuration.path, self._reference)

    def _save_anew(self, work: _MountingWork) -> None:
        """Save the view that a person has confirmed. If it cannot be, the mounting is unconfirmed again."""
        try:
            reference = make_reference(work.frames, self._lens, work.hidden)
            save_reference(self._configuration.path, reference)
        except StadimeterError as error:
            self._say(work, MountingStatus.UNCONFIRMED, f"confirmed, but not saved: {error}")
        else:
            self._use(reference)

    def _use(self, reference: MountingReference) -> None:
        self._reference, self._judge = reference, judge_by(reference, self._configuration, self._lens)

    def _say(self, work: _MountingWork, status: MountingStatus, reason: str) -> None:
        """Say how the mounting is, unless a person has confirmed it meanwhile, or has yet to."""
        if self._in_hand is work and (status is MountingStatus.UNCONFIRMED or not self.mounting.is_unconfirmed):
            self.mounting = Mounting(status=status, reason=reason)


def watch_of(configuration: Configuration) -> tuple[MountingWatch | None, str]:
    """Return the watch of a run, not started, or why there is none although one is wanted."""
    try:
        reference = load_reference(configuration.path)
    except StateError as error:
        return None, f"the mounting of the camera is not watched: {error}"
    lens = configuration.camera_model
    if reference is None or lens is None:
        wanted = "no view of the camera was saved; `stadimeter mounting save` does (mounting.watch = true)"
        return None, wanted if configuration.mounting.watch else ""
    return MountingWatch(configuration, lens, reference), ""


def _is_confirmed(record: CycleRecord) -> bool:
    """Return whether a person has confirmed an unconfirmed mounting in this cycle."""
    events = (each for each in record.decision.events if each.source == MOUNTING)
    return any(each.kind is EventKind.FAULT_CLEARED for each in events)
