"""Which of a target's sides is compared with which of its sizes."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.detection import Detection
from stadimeter.core.target import BallSize, DiscSize, SheetSize, TagSize, TargetSize


@dataclass(frozen=True, slots=True, kw_only=True)
class ApparentSize:
    """A length of the target beside how long it appears.

    Attributes:
        size_m: The length.
        apparent: How long it appears: in pixels, or per unit of depth, whatever was asked for.
        name: What the length is, such as ``width``.
    """

    size_m: float
    apparent: float
    name: str

    @property
    def share(self) -> float:
        """How long it appears for each metre; the nearer, the more."""
        return self.apparent / self.size_m


def apparent_size(detection: Detection, size: TargetSize, fx_px: float = 1.0, fy_px: float = 1.0) -> ApparentSize:
    """Choose the length that tells the distance.

    Of a ball it is the diameter. Of a tag it is the longer side and of a disc the larger diameter, which are turned
    away the least. Of a sheet it is the side that is named, or with ``auto`` the one that gives the nearer distance:
    turning a sheet away from the camera can only shorten a side. With ``auto`` the longer side in the picture is taken
    to be the longer side of the sheet, however it hangs. Once a sheet is turned so far that its longer side appears as
    the shorter one (40 degrees for letter paper), that is wrong; naming the side then helps.

    Args:
        detection: A target that was found.
        size: Its size.
        fx_px: What widths in pixels are divided by, such as the focal length; 1 leaves them in pixels.
        fy_px: The same for heights.

    Returns:
        The length.
    """
    width, height = detection.width_px / fx_px, detection.height_px / fy_px
    if isinstance(size, BallSize):
        return ApparentSize(size_m=size.diameter_m, apparent=(width + height) / 2, name="diameter")
    if isinstance(size, TagSize):
        return ApparentSize(size_m=size.side_m, apparent=max(width, height), name="side")
    if isinstance(size, DiscSize):
        return ApparentSize(size_m=size.diameter_m, apparent=max(width, height), name="diameter")
    if size.known_side == "width":
        return ApparentSize(size_m=size.width_m, apparent=width, name="width")
    if size.known_side == "height":
        return ApparentSize(size_m=size.height_m, apparent=height, name="height")
    return max(_sides(size, width, height), key=lambda side: side.share)


def _sides(size: SheetSize, width: float, height: float) -> tuple[ApparentSize, ApparentSize]:
    """Pair the sheet's sides with those in the picture, longer with longer."""
    shorter_m, longer_m = sorted((size.width_m, size.height_m))
    shorter, longer = sorted((width, height))
    return (
        ApparentSize(size_m=longer_m, apparent=longer, name="longer side"),
        ApparentSize(size_m=shorter_m, apparent=shorter, name="shorter side"),
    )
