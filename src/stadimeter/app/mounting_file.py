"""The view of a camera that was saved: a file beside the configuration, written whole.

It holds directions and descriptors of features, no picture, and the lens that gave the directions. Where the folder of
the configuration may not be written, as below systemd, it is in the folder of the service's state; the newer counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.app.service_folders import mounting_places
from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.loader import Configuration
from stadimeter.config.untrusted_file import is_file, read_untrusted
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import StateError, UnreadableError
from stadimeter.perception.background import FEATURE, BackgroundView, keep_still, look_at
from stadimeter.perception.mounting import MountingJudge, limits_for

# Eight views of 480 features take 240 kB.
MAX_BYTES = 1_000_000

ANEW = "save the view anew with `stadimeter mounting save`"

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
    views: list[BackgroundView]

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
        return f"{why}; save it anew with `stadimeter mounting save`" if why else ""


def judge_by(reference: MountingReference, configuration: Configuration, lens: CameraModel) -> MountingJudge:
    """Return the judge of the views of a configuration's camera by a saved one."""
    limits = limits_for(lens, configuration.tilt_sigma_rad, is_on_robot=configuration.base is not None)
    return MountingJudge(list(reference.views), limits)


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

    `stadimeter mounting save` calls it, a run whose mounting is confirmed, and whatever certifies a site.

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
    view = keep_still([look_at(each, small, hidden) for each in moments])
    return MountingReference(
        saved_unix_s=time.time(),
        size_px=(first.width_px, first.height_px),
        sensor=first.optics.sensor if first.optics is not None else "",
        lens=lens_figures(small),
        views=[view],
    )


def seen_through(reference: MountingReference, lens: CameraModel, other: CameraModel) -> MountingReference:
    """Return a view, saved with a lens, as with another model of that lens; as it is if it was saved with a third."""
    before, after = (each.scaled_to(*reference.size_px) for each in (lens, other))
    if reference.lens != lens_figures(before):
        return reference
    views = []
    for view in reference.views:
        features, focal_px = view.features.copy(), view.focal_px * after.fx_px / before.fx_px
        features["place"] = after.directions(before.project(features["place"]))
        views.append(replace(view, data=features.tobytes(), focal_px=focal_px))
    return replace(reference, lens=lens_figures(after), views=views)


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
        return unpack_reference(read_untrusted(path, MAX_BYTES), path)
    except UnreadableError as error:
        raise StateError(f"{path}: {error.reason}; {ANEW}") from error


def unpack_reference(data: bytes, path: Path) -> MountingReference:
    """Return a view from the bytes that a file holds.

    Raises:
        StateError: They are damaged.
    """
    try:
        found = msgspec.msgpack.decode(data, type=MountingReference)
    except ValueError as error:
        raise StateError(f"{path}: it is damaged; {ANEW}") from error
    if found.v != 1 or not found.views or not all(map(_is_whole, found.views)):
        raise StateError(f"{path}: it is damaged; {ANEW}")
    return found


def _is_whole(view: BackgroundView) -> bool:
    if not view.data or len(view.data) % FEATURE.itemsize:
        return False
    sums = (view.features[name].sum() for name in ("place", "sharpness"))
    return view.blur_slope < 0 and all(map(math.isfinite, (view.blur_px2, view.blur_slope, *sums)))
