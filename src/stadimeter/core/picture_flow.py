"""The distance that the picture has moved, as the core sees it: without its pixels."""

from __future__ import annotations

from msgspec import Struct


class FlowSince(Struct, frozen=True, kw_only=True):
    """Distance that the blocks of a picture have moved sideways since an earlier one, in pixels of a reduced picture.

    Attributes:
        since_s: The capture time of the earlier picture.
        step_s: The time from the picture before to this one.
        focal_px: The focal length at the reduced width.
        aside_px: How far the blocks with texture are from the optical axis sideways, as a median.
        blocks: How many blocks have texture: only of these can be said whether they moved.
        shift2_px2: The square of the shift, as a median over the blocks with texture. Noise that is new in each picture
            adds nothing to it, so it may be below 0 for a picture that stands still.
        sigma_px2: Standard deviation of that median, from how the blocks scatter.
        is_slid: Whether the earlier picture was slid over this one first, so that no turn of the camera is left in it.
    """

    since_s: float
    step_s: float
    focal_px: float
    aside_px: float
    blocks: int
    shift2_px2: float
    sigma_px2: float
    is_slid: bool = False


class PictureFlow(Struct, frozen=True, kw_only=True):
    """Motion as a picture shows it.

    Attributes:
        textured: The share of its blocks that have texture, 0 to 1.
        since: Its flow since earlier pictures; empty while there are none.
        again: Its flow since the pictures of long ago that look most like it; here of three blocks in four, in place of
            the median.
    """

    textured: float
    since: tuple[FlowSince, ...] = ()
    again: tuple[FlowSince, ...] = ()
