"""A second camera that cannot measure beside the first: it is the same one, or the stereo file is of other pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel, is_one_aspect

# The options of cameras that say which one is meant; the last of a simulated one.
_WHICH = ("device", "device_file", "camera", "path", "paths", "baseline")


def second_camera_errors(subject: Subject) -> Iterator[Finding]:
    """Find what keeps both cameras from measuring together, or one from measuring a thing of unknown size."""
    first, second, rig = subject.draft.camera, subject.draft.second_camera, subject.draft.rig
    if first is None or second is None:
        yield from _without_size(subject.draft)
        return
    if first.driver == second.driver and _device(first) == _device(second):
        hint = "name another device; where it is simulated, write baseline"
        yield Finding(("second_camera", "driver"), "this is the first camera once more", hint, "used-twice")
    if subject.draft.camera_table.model is not None:
        message = "the stereo file of [second_camera] has the lenses of both cameras"
        yield Finding(("camera", "model"), message, "leave it out", "lens-twice")
    if rig is not None:
        yield from _unfit("camera", first, rig.left)
        yield from _unfit("second_camera", second, rig.right)
    for target in subject.draft.targets:
        if not target.options.needs_pixels:
            message = f"'{target.driver}' looks at no picture, so a second camera shows it nothing"
            yield Finding(("targets", target.name, "detector"), message, "leave [second_camera] out", "stereo-unfit")


def _without_size(draft: Draft) -> Iterator[Finding]:
    """Find targets of unknown size that nothing measures."""
    for target in draft.targets:
        table = draft.target_tables.get(target.name)
        if table is not None and not table.on_floor and _is_size_unknown(target):
            hint = "add a section [second_camera], write on_floor for what stands on the floor, or measure its size"
            message = "one camera measures no distance of a thing whose size is not known"
            yield Finding(("targets", target.name), message, hint, "size-unknown")


def _unfit(section: str, choice: DriverChoice, lens: CameraModel) -> Iterator[Finding]:
    width_px, height_px = (getattr(choice.options, key, None) for key in ("width_px", "height_px"))
    if width_px and height_px and not is_one_aspect((width_px, height_px), (lens.width_px, lens.height_px)):
        message = (
            f"pictures of {width_px}x{height_px} have another aspect than those of the stereo file, "
            f"{lens.width_px}x{lens.height_px}, so they show another part of the view"
        )
        hint = "set width_px and height_px so, or calibrate at this resolution"
        yield Finding((section, "width_px"), message, hint, "stereo-unfit")


def _is_size_unknown(target: DriverChoice) -> bool:
    sigmas = (getattr(target.options, key, None) for key in ("tolerance", "height", "width", "eye_distance"))
    return any(getattr(each, "sigma_m", each) == math.inf for each in sigmas)


def _device(choice: DriverChoice) -> list[object]:
    return [_real(getattr(choice.options, key, None)) for key in _WHICH]


def _real(device: object) -> object:
    """Return a device by its own path: it has several names, and a number is one of them."""
    path = f"/dev/video{device}" if isinstance(device, int) else device
    return os.path.realpath(path) if isinstance(path, str) and path.startswith("/dev/") else device
