"""A calibration while a run goes on: from one picture, of a target at a distance measured with a tape.

Nothing is written and nothing changes: the answer is a camera file. A person puts it where the configuration names it,
and has the run restarted. A run may not write its configuration, and a lens that changed by a message would
move every threshold without a word.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from stadimeter.app.control.messages import CalibrateArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.config.camera_file import camera_file_text
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus, TargetShape
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.live.history import RunHistory


def calibrate_on_request(parts: Parts, history: RunHistory, args: CalibrateArgs, answer: Answer) -> None:
    """Have a lens computed from the newest picture, in the thread of the one who asks."""
    seen = history.seen
    record, frame = (seen.record, seen.frame) if seen is not None else (None, None)
    shapes = {name: each.target_shape for name, each in parts.cycle.detectors.items()}
    answer(partial(calibrate_now, args, record, frame, shapes, parts.configuration.camera_model))


def calibrate_now(
    args: CalibrateArgs,
    record: CycleRecord | None,
    frame: Frame | None,
    shapes: Mapping[str, TargetShape],
    lens: CameraModel | None,
) -> Reply:
    """Return the camera file by which the newest picture shows a target at the distance that it has.

    Args:
        record: The cycle in which the frame was new.
        shapes: What each target is, by its name.
        lens: The one that the run measures with.
    """
    if args.target not in shapes and (args.target or len(shapes) != 1):
        return Reply(error=f"target: write one of {', '.join(shapes)}")
    from stadimeter.ranging.calibration import KnownDistance, calibrate  # noqa: PLC0415 - few runs are asked for it

    target = args.target or next(iter(shapes))
    if lens is not None and any(lens.distortion):
        return Reply(
            error="the lens has distortion, which one distance does not tell; use `stadimeter calibrate board`"
        )
    found = {each.target: each for each in record.detections} if record is not None else {}
    detection = found.get(target)
    if frame is None or detection is None or detection.status is not DetectionStatus.FOUND:
        why = detection.reason if detection is not None else "there is no picture of it"
        return Reply(error=f"'{target}' is not measured now: {why}")
    known = KnownDistance(
        picture="the newest frame",
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=detection,
        size=shapes[target],
        depth_m=args.distance,
    )
    try:
        model = calibrate([known], date=time.strftime("%Y-%m-%d")).camera_model
    except CalibrationError as error:
        return Reply(error=str(error))
    return Reply(
        {
            "target": target,
            "focal_px": round(model.fx_px, 2),
            "focal_relative_sigma": round(model.focal_relative_sigma, 5),
            "camera_file": camera_file_text(model),
        }
    )
