"""A picture and the moment it was taken; and the pictures that came lately, known again by a hash."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

# The pictures that came lately, known again by a hash -----------------------------------------------------------------

# Pictures are remembered for this long, so that a cycle of up to 20 s is noticed: drivers cycle through 3 to 10
# buffers, senders through a recording. The number bounds the memory: 200 pictures a second, 0.7 MB.
REMEMBERED_S = 25.0
MAX_REMEMBERED = 5000
BREAK_S = 1.0


class SeenPictures:
    """Knows again the pictures of the last `REMEMBERED_S`. Breaks do not count: what came before them stays known."""

    def __init__(self) -> None:
        self._seen_at_s: dict[int, float] = {}  # by hash, the one that came last at the end
        self._watched_s = 0.0
        self._came_at_s = 0.0

    def note(self, hashed: int, now_s: float) -> bool:
        """Note that a picture came; return whether it came before."""
        self._watched_s += min(max(now_s - self._came_at_s, 0.0), BREAK_S)
        self._came_at_s = now_s
        seen = self._seen_at_s
        came_before = seen.pop(hashed, None) is not None
        seen[hashed] = self._watched_s
        while len(seen) > MAX_REMEMBERED or seen[next(iter(seen))] < self._watched_s - REMEMBERED_S:
            del seen[next(iter(seen))]
        return came_before

    def __contains__(self, hashed: int) -> bool:
        return hashed in self._seen_at_s

    def __len__(self) -> int:
        return len(self._seen_at_s)


# A picture and the moment it was taken --------------------------------------------------------------------------------

Image = NDArray[np.uint8]

# How coarsely colour is stored beside brightness (ITU-R BT.601): for every pixel, for every second one across, or for
# every second one across and down.
Subsampling = Literal["4:4:4", "4:2:2", "4:2:0"]

SUBSAMPLINGS: tuple[Subsampling, ...] = get_args(Subsampling)

# How many pixels share one sample of colour, across and down.
CHROMA_PITCH_PX: dict[Subsampling, tuple[int, int]] = {"4:4:4": (1, 1), "4:2:2": (2, 1), "4:2:0": (2, 2)}


# Crops that differ by no more than this share of their longer side count as the same: they are rounded to blocks.
CROP_TOLERANCE = 0.002

# Lens positions that differ by no more than this do too: it changes the focal length by 0.03 % in a small camera.
LENS_TOLERANCE_DPT = 0.05


class Optics(Struct, frozen=True, kw_only=True):
    """The settings of a camera that change its focal length in pixels, or where its optical axis meets the picture.

    Attributes:
        sensor: The sensor's name, such as ``imx708``.
        sensor_size_px: Width and height of the sensor's mode, which pixels are put together; it changes no more than
            the crop that goes with it.
        crop_px: The part of the sensor that fills the picture: left, top, width and height in the sensor's own pixels.
        lens_position_dpt: Where the lens stands, in dioptres; None for one that is turned by hand, or that moves.
        upside_down: Whether the picture was turned by half a turn.
    """

    sensor: str
    sensor_size_px: tuple[int, int]
    crop_px: tuple[int, int, int, int]
    lens_position_dpt: float | None = None
    upside_down: bool = False

    def change_to(self, now: Optics) -> str:
        """Describe what has changed since these were recorded, and what to do about it; empty if nothing has."""
        if now.sensor != self.sensor:
            return f"the camera file is for the sensor {self.sensor}, and this is {now.sensor}; calibrate this camera"
        if now.upside_down != self.upside_down:
            wanted = str(self.upside_down).lower()
            return f"calibrated the other way up; set upside_down = {wanted} in [camera], or calibrate again"
        most_px = CROP_TOLERANCE * max(self.crop_px)
        if any(abs(here - there) > most_px for here, there in zip(now.crop_px, self.crop_px, strict=True)):
            return (
                f"calibrated with another crop of the sensor: {list(self.crop_px)}, now it is {list(now.crop_px)}; "
                f"calibrate again, or set crop_px = {list(self.crop_px)}, sensor_width_px = {self.sensor_size_px[0]} "
                f"and sensor_height_px = {self.sensor_size_px[1]} in [camera]"
            )
        if self.lens_position_dpt is None or now.lens_position_dpt is None:
            return ""
        if abs(now.lens_position_dpt - self.lens_position_dpt) > LENS_TOLERANCE_DPT:
            return (
                f"calibrated with the lens at {self.lens_position_dpt:.3g} dioptres, now it is at "
                f"{now.lens_position_dpt:.3g}; set lens_position_dpt = {self.lens_position_dpt:.3g} in [camera], or "
                "calibrate again"
            )
        return ""


class SensorBoxes(Struct, frozen=True, eq=False):
    """The boxes that a network running on the camera's sensor has found in a frame.

    Attributes:
        corners_px: Left, top, right and bottom of each box in the frame's pixels, shape ``(n, 4)``.
        scores: How sure the network is of each, 0 to 1, shape ``(n,)``.
        classes: What each is, by the name or else the number that the network has for it.
        input_px: How many pixels of the network's input the longer side of the frame was; boxes err by some of these.
    """

    corners_px: NDArray[np.float64]
    scores: NDArray[np.float64]
    classes: tuple[str, ...]
    input_px: float = 320.0


class Frame(Struct, frozen=True, eq=False):
    """One picture from a camera.

    Attributes:
        image: The picture, shape ``(height, width, 3)``, 8 bits a channel, blue first as OpenCV has it.
        captured_at_s: When it was exposed, on the run's monotonic clock; its arrival where the driver knows no better.
        sequence: Counts the frames that the camera has delivered, from 0. A gap is a frame that was passed over.
        source: Where it came from, such as a file's path; empty for a live camera.
        subsampling: How coarsely the camera or the file stored its colour, as far as the driver knows.
        optics: How the camera was set, if its driver knows; the same object for as long as that stays.
        exposure_s: For how long it was exposed, if the driver knows.
        boxes: What a network on the sensor has found in it; None where none runs, or has not ended yet.
    """

    image: Image
    captured_at_s: float
    sequence: int
    source: str = ""
    subsampling: Subsampling = "4:4:4"
    optics: Optics | None = None
    exposure_s: float | None = None
    boxes: SensorBoxes | None = None

    @property
    def chroma_pitch_px(self) -> tuple[int, int]:
        """Number of pixels that share one sample of colour, across and down."""
        return CHROMA_PITCH_PX[self.subsampling]

    @property
    def width_px(self) -> int:
        """The width of the image."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """The height of the image."""
        return int(self.image.shape[0])
