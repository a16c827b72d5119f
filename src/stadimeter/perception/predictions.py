"""Which frames are searched whole, and in which a target is looked for first where it was.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. What is
found there is taken, so something that was once mistaken for the target could hold its place for ever, while the target
is in plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.
"""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Prediction
from stadimeter.core.target import TargetSize
from stadimeter.core.track import Track
from stadimeter.ranging.prediction import Motion, follow, predict

SEARCH_EVERY_S = 1.0
"""Each target is looked for in the whole frame this often, in time of capture."""


class Expectations:
    """Says where each target is expected. One for each run."""

    def __init__(self) -> None:
        self._searched_at_s: dict[str, float] = {}
        self._motions: dict[str, Motion | None] = {}

    def of(self, track: Track | None, size: TargetSize, camera: CameraModel, at_s: float) -> Prediction | None:
        """Say where a target is expected in a frame. Asked once for each target and frame.

        Args:
            track: What is known of the target; None for nothing.
            size: Its size.
            camera: The camera model at the frame's resolution.
            at_s: When the frame was taken, on the run's monotonic clock.

        Returns:
            The prediction; None if the whole frame is to be searched, since nothing is expected or it is time to.
        """
        if track is None:
            return None
        motion = self._motions[track.target] = follow(self._motions.get(track.target), track)
        since_s = at_s - self._searched_at_s.get(track.target, -math.inf)
        expected = predict(track, size, camera, at_s, motion) if 0 <= since_s < SEARCH_EVERY_S else None
        if expected is None:
            self._searched_at_s[track.target] = at_s
        return expected
