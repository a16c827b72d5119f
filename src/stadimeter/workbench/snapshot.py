"""Pictures of a camera with exactly the settings that a run uses, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from stadimeter.config.plugins import DriverChoice
from stadimeter.core.frame import Frame
from stadimeter.errors import EndOfFramesError
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, opened
from stadimeter.workbench.picture_quality import picture_remarks

OTHER_PROGRAMS = (
    "a photograph by another program may have another focal length: take pictures for calibration in this way, with"
    " the camera's settings of the configuration"
)
"""What a person should know who wants to calibrate from pictures."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Snapshot:
    """A picture of a camera.

    Attributes:
        settings: Which settings the camera did not take, a sentence each.
        faults: What is wrong with the picture, a sentence each.
    """

    frame: Frame
    settings: tuple[str, ...]
    faults: tuple[str, ...]


def snapshots(choice: DriverChoice, *, apart_s: float = 0.0) -> Generator[Snapshot, None, None]:
    """Yield pictures of a camera without an end, or until a recording ends. Close the iterator to close the camera.

    Args:
        apart_s: How long to wait from one to the next, at least.

    Raises:
        DriverError: The camera cannot be opened, or no frame comes.
        PictureError: A recording cannot be read.
    """
    with opened(choice) as source:
        next_s = float("-inf")
        while True:
            try:
                frame = source.capture.latest(SETTLING_WAIT_S)
            except EndOfFramesError:
                return
            if frame.captured_at_s >= next_s:
                next_s = frame.captured_at_s + apart_s
                yield Snapshot(
                    frame=frame,
                    settings=source.capture.remarks(),
                    faults=picture_remarks(frame.image, frame.exposure_s),
                )
