"""Watches whether the camera of a run is still where it was: once a minute, and after each gap of the camera.

The loop hands over two of its pictures and goes on; a thread of low priority compares them with the saved view.
What it finds is there from the next cycle on, and stays until a person confirms it: then the present view is saved in
place of the former one. Dirt that was wiped off clears itself.
"""

from __future__ import annotations

import math
import os
import threading
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.mounting_file import PAIR, PAIRS, MountingReference, load_reference, make_reference, save_reference
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.core.mounting import Mounting, MountingStatus
from stadimeter.core.operator import OperatorCommand
from stadimeter.errors import StadimeterError, StateError
from stadimeter.operator_actions import OperatorAction
from stadimeter.perception.background import look_at
from stadimeter.perception.mounting import Judgement, MountingJudge, MountingLimits, limits_for

EVERY_S = 60.0

# Two pictures of one moment: so far apart that their noise differs, so near that the light does not.
APART_S = 0.1

# A camera that gave nothing for this long may have been unplugged, and touched.
GAP_S = 2.0

# How low the priority of the thread is: it gets a tenth of the time of the loop where both want all.
NICE = 10


class _MountingWork(Struct, frozen=True):
    """Pictures to look at; after a confirmation they become the saved view."""

    frames: list[Frame]
    hidden: list[NDArray[np.float64]]
    round: int
    is_confirmed: bool


class MountingWatch:
    """A listener of the loop that knows how the mounting is.

    Args:
        reference: The view that was saved.

    Attributes:
        mounting: What the newest check says.
        stops_outputs: Whether nothing may move while the mounting is unconfirmed.
        newest: What the newest check has found, with its figures; None before the first.
    """

    def __init__(
        self,
        configuration: Path,
        lens: CameraModel,
        reference: MountingReference,
        limits: MountingLimits,
        *,
        stops_outputs: bool = False,
    ) -> None:
        self.mounting = Mounting(status=MountingStatus.NOT_JUDGED, reason="not looked at yet")
        self.stops_outputs = stops_outputs
        self.newest: Judgement | None = None
        self._configuration, self._lens, self._limits = configuration, lens, limits
        self._reference = reference
        self._judge = MountingJudge(list(reference.views), limits, list(reference.steadiness))
        self._is_lasting = False
        self._due_s = self._last_s = -math.inf
        self._frames: list[Frame] = []
        self._hidden: list[NDArray[np.float64]] = []
        self._round = 0
        self._is_confirmed = self._is_busy = False
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
        return (
            f"the mounting is unconfirmed: {self.mounting.reason}"
            if self.stops_outputs and (self.mounting.is_unconfirmed)
            else ""
        )

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
        if record.observation.operator_commands and _is_confirmed(record):
            self.mounting = Mounting()
            self._round += 1
            self._is_confirmed, self._due_s, self._frames = True, -math.inf, []
        if frame is None:
            return
        if frame.captured_at_s - self._last_s > GAP_S:
            self._due_s, self._frames = -math.inf, []
        self._last_s = frame.captured_at_s
        if self._is_busy or frame.captured_at_s < self._due_s:
            return
        if self._frames and frame.captured_at_s - self._frames[-1].captured_at_s < APART_S:
            return
        self._hidden = [] if not self._frames else self._hidden
        self._frames.append(frame)
        self._hidden += [each.outline_px for each in record.detections if len(each.outline_px)]
        if len(self._frames) >= (PAIR * PAIRS if self._is_confirmed else PAIR):
            self._hand_over(frame.captured_at_s)

    def _hand_over(self, now_s: float) -> None:
        self._is_busy = True
        self._works.put(_MountingWork(self._frames, self._hidden, self._round, self._is_confirmed))
        self._frames, self._due_s, self._is_confirmed = [], now_s + EVERY_S, False

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (work := self._works.get()) is not None:
            try:
                self._attend(work)
            except Exception as error:  # noqa: BLE001 - a defect here must not end the watch, nor stay unsaid
                self._not_judged(work, f"the check failed: {error}")
            finally:
                self._is_busy = False

    def _attend(self, work: _MountingWork) -> None:
        lens = self._lens.for_frame(work.frames[0])
        saved = load_reference(self._configuration)
        if saved is not None and saved.saved_unix_s != self._reference.saved_unix_s:  # by the command, meanwhile
            self._use(saved)
            self._say(work, Mounting())
        if work.is_confirmed:
            self._save_anew(work)
        elif why := self._reference.why_not_for(work.frames[0], lens):
            self._not_judged(work, why)
        else:
            self._take_in(work, self._judge.judge(look_at([each.image for each in work.frames], lens, work.hidden)))

    def _take_in(self, work: _MountingWork, found: Judgement) -> None:
        self.newest = found
        if found.words:
            self._is_lasting = self._is_lasting or found.settled != {"dirty"}
            self._say(work, Mounting(status=MountingStatus.UNCONFIRMED, reason=found.words))
        elif self.mounting.is_unconfirmed and (self._is_lasting or found.kinds or found.not_judged):
            return
        elif found.not_judged:
            self._not_judged(work, found.not_judged)
        else:
            self._say(work, Mounting())
        if found.has_learnt:
            self._reference = replace(
                self._reference, views=list(self._judge.views), steadiness=list(self._judge.steadiness)
            )
            with suppress(StadimeterError):  # it is learnt again after a restart
                save_reference(self._configuration, self._reference)

    def _save_anew(self, work: _MountingWork) -> None:
        """Save the view that a person has confirmed. If it cannot be, the mounting is unconfirmed again."""
        try:
            reference = make_reference(work.frames, self._lens, work.hidden)
            save_reference(self._configuration, reference)
        except StadimeterError as error:
            self._say(work, Mounting(status=MountingStatus.UNCONFIRMED, reason=f"confirmed, but not saved: {error}"))
            return
        self._use(reference)

    def _use(self, reference: MountingReference) -> None:
        self._reference = reference
        self._judge = MountingJudge(list(reference.views), self._limits, list(reference.steadiness))
        self._is_lasting = False

    def _not_judged(self, work: _MountingWork, why: str) -> None:
        if not self.mounting.is_unconfirmed:
            self._say(work, Mounting(status=MountingStatus.NOT_JUDGED, reason=why))

    def _say(self, work: _MountingWork, mounting: Mounting) -> None:
        if work.round == self._round:  # else a person has confirmed what this says meanwhile
            self.mounting = mounting


def watch_of(configuration: Configuration) -> tuple[MountingWatch | None, str]:
    """Return the watch of a run, not started, or why there is none although one is wanted."""
    try:
        reference = load_reference(configuration.path)
    except StateError as error:
        return None, f"the mounting of the camera is not watched: {error}"
    lens, table = configuration.camera_model, configuration.mounting
    if reference is None or lens is None:
        wanted = "no view of the camera was saved; `stadimeter mounting save` does (mounting.watch = true)"
        return None, wanted if table.watch else ""
    limits = limits_for(lens, configuration.tilt_sigma_rad, is_on_robot=configuration.base is not None)
    stops = table.when_moved == "stop"
    return MountingWatch(configuration.path, lens, reference, limits, stops_outputs=stops), ""


def _is_confirmed(record: CycleRecord) -> bool:
    """Return whether an operator has confirmed the mounting in this cycle."""
    accepted = {each.id for each in record.decision.answers if each.accepted}
    given = (each for each in record.observation.operator_commands if isinstance(each, OperatorCommand))
    return any(each.action is OperatorAction.CONFIRM_MOUNTING and each.id in accepted for each in given)
