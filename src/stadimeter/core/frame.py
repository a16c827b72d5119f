"""A picture and the moment it was taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

Subsampling = Literal["4:4:4", "4:2:2", "4:2:0"]
"""How coarsely colour is stored beside brightness (ITU-R BT.601): for every pixel, for every second one across, or for
every second one across and down."""

SUBSAMPLINGS: tuple[Subsampling, ...] = get_args(Subsampling)

CHROMA_PITCH_PX: dict[Subsampling, tuple[int, int]] = {"4:4:4": (1, 1), "4:2:2": (2, 1), "4:2:0": (2, 2)}
"""How many pixels share one sample of colour, across and down."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture from a camera.

    Attributes:
        image: The picture, shape ``(height, width, 3)``, 8 bits a channel, blue first as OpenCV has it.
        captured_at_s: When it was exposed, on the run's monotonic clock; its arrival where the driver knows no better.
        sequence: Counts the frames that the camera has delivered, from 0. A gap is a frame that was passed over.
        source: Where it came from, such as a file's path; empty for a live camera.
        subsampling: How coarsely the camera or the file stored its colour, as far as the driver knows.
    """

    image: Image
    captured_at_s: float
    sequence: int
    source: str = ""
    subsampling: Subsampling = "4:4:4"

    @property
    def chroma_pitch_px(self) -> tuple[int, int]:
        """How many pixels share one sample of colour, across and down."""
        return CHROMA_PITCH_PX[self.subsampling]

    @property
    def width_px(self) -> int:
        """The width of the image."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """The height of the image."""
        return int(self.image.shape[0])
