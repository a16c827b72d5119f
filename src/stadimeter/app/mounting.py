"""Watches whether the camera of a run is still where it was: once a minute, and after each gap of the camera.

The loop hands over some of its pictures and goes on; a thread of low priority compares them with the saved view.
What it finds is there from the next cycle on, and stays until a person confirms it: then the present view is saved in
place of the former one.
"""

from __future__ import annotations

import math
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.mounting_file import (
    MOMENTS,
    PICTURES,
    MountingReference,
    judge_by,
    keep_apart,
    load_reference,
    make_reference,
    save_reference,
)
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import MOUNTING, Mounting, MountingStatus
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.errors import StadimeterError, StateError
from stadimeter.perception.background import look_at

EVERY_S = 60.0

# A camera that gave nothing for this long may have been unplugged, and touched.
GAP_S = 2.0

# How low the priority of the thread is: it gets a tenth of the time of the loop where both want all.
NICE = 10


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
        self._last_s = self._due_s = -math.inf
        self._is_confirmed = False
        self._frames: list[Frame] = []
        self._hidden: list[NDArray[np.float64]] = []
        self._check: Future[Mounting] | None = None
        self._thread = ThreadPoolExecutor(1, "mounting", _lower_priority)

    def close(self) -> None:
        """Look at no more pictures."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def why_not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in words; empty if it may."""
        is_stopped = self.mounting.is_unconfirmed and self._configuration.mounting.when_moved == "stop"
        return f"the mounting is unconfirmed: {self.mounting.reason}" if is_stopped else ""

    def trouble(self) -> str:
        """Return that distances are unconfirmed, in words; empty if they are not."""
        return (
            f"distances are unconfirmed, the camera is not mounted as it was saved: {self.mounting.reason}; "
            "put it right, or `stadimeter mounting confirm`"
            if self.mounting.is_unconfirmed
            else ""
        )

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle. Costs nothing but once a minute, and then a few references to pictures."""
        if record.mark and _is_confirmed(record):
            self.mounting, self._check = Mounting(), None  # what is in hand shows what was confirmed
            self._begin(is_confirmed=True)
        if self._check is not None and self._check.done():
            self._take_in(self._check)
        if frame is None:
            return
        now_s, before_s, self._last_s = frame.captured_at_s, self._last_s, frame.captured_at_s
        if now_s - before_s > GAP_S:
            self._begin(is_confirmed=self._is_confirmed)
        if self._check is not None or now_s < self._due_s:
            return
        self._frames = keep_apart(self._frames, frame)
        self._hidden += [each.outline_px for each in record.detections if len(each.outline_px)]
        if len(self._frames) >= (PICTURES * MOMENTS if self._is_confirmed else PICTURES):
            work = self._save_anew if self._is_confirmed else self._look
            self._check = self._thread.submit(work, self._frames, self._hidden)
            self._begin(due_s=now_s + EVERY_S)

    def _begin(self, *, is_confirmed: bool = False, due_s: float = -math.inf) -> None:
        """Gather pictures from some time on; those after a confirmation become the saved view."""
        self._is_confirmed, self._due_s, self._frames, self._hidden = is_confirmed, due_s, [], []

    def _take_in(self, check: Future[Mounting]) -> None:
        """Keep what a check says, unless a person has yet to confirm what an earlier one did."""
        self._check = None
        try:
            found = check.result()
        except Exception as error:  # noqa: BLE001 - a defect there must not end the run, nor stay unsaid
            found = Mounting(status=MountingStatus.NOT_JUDGED, reason=f"the check failed: {error}")
        if found.is_unconfirmed or not self.mounting.is_unconfirmed:
            self.mounting = found

    def _look(self, frames: list[Frame], hidden: list[NDArray[np.float64]]) -> Mounting:
        """Return the mounting as some pictures show it. Runs in the thread."""
        saved = load_reference(self._configuration.path)
        if saved is not None and saved.saved_unix_s != self._reference.saved_unix_s:  # by the command, meanwhile
            self._use(saved)
            self.mounting = Mounting()
        lens = self._lens.for_frame(frames[0])
        if why := self._reference.why_not_for(frames[0], lens):
            return Mounting(status=MountingStatus.NOT_JUDGED, reason=why)
        judgement = self._judge.judge(look_at([each.image for each in frames], lens, hidden))
        if judgement.has_learnt:
            self._reference = replace(self._reference, views=list(self._judge.views))
            with suppress(StadimeterError):  # it is learnt again after a restart
                save_reference(self._configuration.path, self._reference)
        if judgement.settled:
            return Mounting(status=MountingStatus.UNCONFIRMED, reason="; ".join(judgement.settled.values()))
        status = MountingStatus.NOT_JUDGED if judgement.not_judged else MountingStatus.AS_SAVED
        return Mounting(status=status, reason=judgement.not_judged)

    def _save_anew(self, frames: list[Frame], hidden: list[NDArray[np.float64]]) -> Mounting:
        """Save the view that a person has confirmed; if it cannot be, the mounting is unconfirmed again."""
        try:
            reference = make_reference(frames, self._lens, hidden)
            save_reference(self._configuration.path, reference)
        except StadimeterError as error:
            return Mounting(status=MountingStatus.UNCONFIRMED, reason=f"confirmed, but not saved: {error}")
        self._use(reference)
        return Mounting()

    def _use(self, reference: MountingReference) -> None:
        self._reference, self._judge = reference, judge_by(reference, self._configuration, self._lens)


def _lower_priority() -> None:
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)


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
    """Check whether a person has confirmed an unconfirmed mounting in this cycle."""
    events = (each for each in record.decision.events if each.source == MOUNTING)
    return any(each.kind is EventKind.FAULT_CLEARED for each in events)
