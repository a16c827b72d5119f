"""Watches whether the camera of a run is still where it was: once a minute, and after each gap of the camera.

The loop hands over some of its pictures and goes on; a thread of low priority compares them with the saved view.
What it finds is there from the next cycle on, and stays until a person confirms it: then the present view is saved in
place of the former one.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.places import mounting_places
from stadimeter.config.files import is_file, read_untrusted, write_atomically
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import MOUNTING, Mounting, MountingStatus
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.errors import StadimeterError, StateError, UnreadableError
from stadimeter.perception import mounting as background

# The view of a camera that was saved: a file beside the configuration, written whole --------------
#
# It holds directions and descriptors of features, no picture, and the lens that gave the directions. Where the
# folder of the configuration may not be written, as below systemd, it is in the folder of the service's state; the
# newer counts.


# Eight views of 480 features take 240 kB.
MAX_BYTES = 1_000_000

ON_ROBOT = "a camera on a robot sees another background all the time"

ANEW = "save the view anew with `stadimeter site save`"

# A view takes more than one picture, for their noise; features that are in each of some moments stand still.
PICTURES, MOMENTS = 4, 3

# Two pictures of a moment: so far apart that their noise differs, so near that the light does not.
APART_S = 0.1

Outlines = Sequence[NDArray[np.float64]]


class MountingReference(Struct, frozen=True, kw_only=True):
    """The content of a file.

    Attributes:
        saved_unix_s: When its first view was saved.
        sensor: The camera's sensor, if its driver knows.
        lens: Focal lengths, optical axis and distortion that gave the directions.
        views: The saved view, and those learnt since, each checked to be whole.
    """

    v: int = 1
    saved_unix_s: float
    size_px: tuple[int, int]
    sensor: str
    lens: tuple[float, ...]
    views: list[background.BackgroundView]

    def why_not_for(self, frame: Frame, lens: CameraModel) -> str:
        """Return why pictures cannot be compared with it, in words; empty if they can."""
        size, sensor = (frame.width_px, frame.height_px), frame.optics.sensor if frame.optics is not None else ""
        why = ""
        if size != self.size_px:
            why = "the saved view has {}x{} px, and the camera gives {}x{} px".format(*self.size_px, *size)
        elif sensor and self.sensor and sensor != self.sensor:
            why = f"the saved view is of the camera {self.sensor}, and this is {sensor}"
        elif lens_figures(lens) != self.lens:
            why = "the view was saved with another camera file"
        return f"{why}; save it anew with `stadimeter site save`" if why else ""


def judge_by(reference: MountingReference, configuration: Configuration, lens: CameraModel) -> background.MountingJudge:
    """Return the judge of the views of a configuration's camera by a saved one."""
    rotation_rad = max(background.MIN_ROTATION_RAD, configuration.tilt_sigma_rad or 0.0)
    zoom = max(background.MIN_ZOOM, lens.focal_relative_sigma)
    return background.MountingJudge(list(reference.views), rotation_rad, zoom)


def lens_figures(lens: CameraModel) -> tuple[float, ...]:
    """Return the figures that decide where a pixel looks to."""
    return (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion)


def keep_apart(frames: list[Frame], frame: Frame) -> list[Frame]:
    """Return the newest pictures, as many as a reference is made of, with one more if it is a while after the last."""
    if frames and frame.captured_at_s - frames[-1].captured_at_s < APART_S:
        return frames
    return [*frames, frame][-PICTURES * MOMENTS :]


def make_reference(frames: Sequence[Frame], lens: CameraModel, hidden: Outlines = ()) -> MountingReference:
    """Return the view that a camera has now, from a dozen pictures: some of each of a few moments.

    Args:
        lens: The camera model, at any resolution of the same aspect.
        hidden: The outlines of targets, in pixels.

    Raises:
        CalibrationError: The pictures do not fit the lens, or show too little that stands still.
    """
    first = frames[0]
    small = lens.for_frame(first)
    images = [each.image for each in frames]
    moments = [images[at - PICTURES : at] for at in range(PICTURES, len(images) + 1, PICTURES)]
    view = background.keep_still([background.look_at(each, small, hidden) for each in moments])
    return MountingReference(
        saved_unix_s=time.time(),
        size_px=(first.width_px, first.height_px),
        sensor=first.optics.sensor if first.optics is not None else "",
        lens=lens_figures(small),
        views=[view],
    )


def save_reference(configuration: Path, reference: MountingReference) -> Path:
    """Write the view of a configuration's camera; return the file.

    Raises:
        StateError: It cannot be written.
    """
    places = mounting_places(configuration)
    for path in places:
        try:
            write_atomically(path, msgspec.msgpack.encode(reference))
        except OSError as error:
            why = error.strerror or str(error)
        else:
            return path
    raise StateError(f"{places[0]}: the view of the camera cannot be saved: {why}")


def load_reference(configuration: Path) -> MountingReference | None:
    """Return the newest saved view of a configuration's camera; None if there is none.

    Raises:
        StateError: The file is damaged.
    """
    found = [_read(path) for path in mounting_places(configuration) if is_file(path)]
    return max(found, key=lambda each: each.saved_unix_s, default=None)


def _read(path: Path) -> MountingReference:
    try:
        found = msgspec.msgpack.decode(read_untrusted(path, MAX_BYTES), type=MountingReference)
    except UnreadableError as error:
        raise StateError(f"{path}: {error.reason}; {ANEW}") from error
    except ValueError as error:
        raise StateError(f"{path}: it is damaged; {ANEW}") from error
    if found.v != 1 or not found.views or not all(map(_is_whole, found.views)):
        raise StateError(f"{path}: it is damaged; {ANEW}")
    return found


def _is_whole(view: background.BackgroundView) -> bool:
    if not view.data or len(view.data) % background.FEATURE.itemsize:
        return False
    sums = (view.features[name].sum() for name in ("place", "sharpness"))
    return view.blur_slope < 0 and all(map(math.isfinite, (view.blur_px2, view.blur_slope, *sums)))


# The comparison while a run goes on ---------------------------------------------------------------


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
            "put it right, or `stadimeter site confirm`"
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
        judgement = self._judge.judge(background.look_at([each.image for each in frames], lens, hidden))
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
    if configuration.base is not None:
        return None, f"a view is not watched: {ON_ROBOT}; leave out mounting.watch, and delete a file .mounting"
    try:
        reference = load_reference(configuration.path)
    except StateError as error:
        return None, f"the mounting of the camera is not watched: {error}"
    lens = configuration.camera_model
    if reference is None or lens is None:
        wanted = "no view of the camera was saved; `stadimeter site save` does (mounting.watch = true)"
        return None, wanted if configuration.mounting.watch else ""
    return MountingWatch(configuration, lens, reference), ""


def _is_confirmed(record: CycleRecord) -> bool:
    """Check whether a person has confirmed an unconfirmed mounting in this cycle."""
    events = (each for each in record.decision.events if each.source == MOUNTING)
    return any(each.kind is EventKind.FAULT_CLEARED for each in events)
