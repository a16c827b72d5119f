"""A picture and the moment it was taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture from a camera.

    Attributes:
        image: The picture, shape ``(height, width, 3)``, 8 bits a channel, blue first as OpenCV has it.
        captured_at_s: When it was exposed, on the run's monotonic clock; its arrival where the driver knows no better.
        sequence: Counts the frames that the camera has delivered, from 0. A gap is a frame that was passed over.
        source: Where it came from, such as a file's path; empty for a live camera.
    """

    image: Image
    captured_at_s: float
    sequence: int
    source: str = ""

    @property
    def width_px(self) -> int:
        """The width of the image."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """The height of the image."""
        return int(self.image.shape[0])
