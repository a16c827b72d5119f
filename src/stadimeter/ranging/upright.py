"""The shape of an upright thing of which one length is known, such as a person, and where one is by that length.

A network tells where a thing is by a box, whose sides err by some percent, and things of a kind differ: adults by 4 %
in height. Both are in the standard deviation, and by one picture no more can be known.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Reading
from stadimeter.ranging.flat import FlatShape
from stadimeter.ranging.similar_triangles import read_by_one_length

KnownLength = Literal["height", "width", "eye_distance"]


class UprightShape(FlatShape, Struct, frozen=True, kw_only=True):
    """Something upright, whose outline is a box around it in one plane.

    Attributes:
        known: Which of its lengths is known.
        length_m: That length.
        relative_sigma: Standard deviation of the length among things of this kind, as a share of it.
        box_sigma: Standard deviation of that length in the picture, as the network finds it, as a share of it.
    """

    known: KnownLength
    length_m: float
    relative_sigma: float = 0.0
    box_sigma: float = 0.0

    @property
    def label(self) -> str:
        """A description of what is known of it."""
        article = "an" if self.known == "eye_distance" else "a"
        return f"thing with {article} {self.known.replace('_', ' ')} of {self.length_m:g} m"

    @property
    def longest_m(self) -> float:
        """The known length."""
        return self.length_m

    @property
    def shortest_m(self) -> float:
        """The known length."""
        return self.length_m

    def size_sigma_px(self, size_px: float) -> float:
        """Return the standard deviation of the known length in the picture."""
        return self.box_sigma * size_px

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where its centre is.

        A height is measured as that of something upright before a level camera: similar triangles are exact for this,
        wherever in the picture it is. Turned up or down by 15 degrees, the camera sees it 3 % too short. A width is
        taken to be square to the optical axis, and eyes to look at the camera.
        """
        x_px, y_px = detection.centre_px
        half = np.array((0.0, detection.height_px / 2) if self.known == "height" else (detection.width_px / 2, 0.0))
        # Both ends of the length, so that the lens's distortion is undone at each.
        ends = camera.directions(np.array(detection.centre_px) + np.stack((-half, half)))
        if self.known != "eye_distance":
            return read_by_one_length(detection, camera, self.length_m, float(np.hypot(*(ends[1] - ends[0]))))
        rays = np.column_stack((ends, np.ones(2)))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        # Two eyes L apart, square to the line of sight, appear under the angle γ: D = L / 2 / tan(γ / 2).
        half_tangent = float(np.linalg.norm(rays[1] - rays[0]) / np.linalg.norm(rays[1] + rays[0]))
        distance_m = self.length_m / 2 / half_tangent
        x, y = camera.direction(x_px, y_px)
        per_depth_m = distance_m / math.sqrt(1 + x * x + y * y)
        return Reading(
            position_m=(x * per_depth_m, y * per_depth_m, per_depth_m),
            noise_share=detection.size_sigma_px / detection.width_px,
        )
