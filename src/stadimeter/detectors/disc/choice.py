"""The choice of the disc among several ellipses in a picture, and whether it can be made at all.

Any ellipse of even brightness, such as another lid, looks the same as the disc. How much each speaks for being it is
one number, see `stadimeter.detectors.disc.edges.evidence`. How many other ellipses a picture holds by chance goes with
the number of outlines in it: before a wall the only one is the disc, among a hundred shapes of all kinds a flat faint
one hardly is. A colour that the user has named leaves as many as have it.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, field

from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.frame import Image
from stadimeter.detectors.disc.edges import INSIDE, EllipseEdges, Trouble, diameters_px
from stadimeter.detectors.disc.ellipse import Ellipse, Lens
from stadimeter.detectors.disc.search import MIN_ASPECT, MIN_FILL, Outline, View
from stadimeter.detectors.hsv import HsvRange

MAX_REJECTED = 8

# Least evidence for a disc for each other outline in the picture. Chosen on rendered clutter of which one shape in
# five is an ellipse: another one is taken in 2 to 3 % of the pictures then.
EVIDENCE_PER_OUTLINE = 5.2

# More outlines than this are texture, which is not elliptical, instead of more things.
MAX_OUTLINES = 100

# Another disc with this share of the evidence may as well be the one.
RIVAL_SHARE = 0.75

# Every eighth pixel tells which share of the picture has the disc's colour; it counts as this at least. So much of the
# disc must have it.
COLOUR_STEP = 8
MIN_PICTURE_COLOUR_SHARE = 0.02
MIN_DISC_COLOUR_SHARE = 0.6

# Number of tests that an outline has passed before its colour is looked at.
TESTS = 10


class RefusedDisc(Struct, frozen=True, kw_only=True, eq=False):
    """A candidate that is no disc, as an ellipse in the picture."""

    ellipse: Ellipse
    is_bright: bool
    trouble: Trouble

    @property
    def described(self) -> str:
        """Description of the candidate, and why it is none."""
        larger, smaller, _ = self.ellipse.axes()
        shade = "bright" if self.is_bright else "dark"
        return f"{shade} outline, {2 * larger:.0f}x{2 * smaller:.0f} px, {self.trouble.text}"


class Disc(Struct, frozen=True, kw_only=True, eq=False):
    """A candidate that is a disc, without the lens's distortion."""

    edges: EllipseEdges
    is_bright: bool
    evidence: float
    truncated: bool


class Judged(Struct, kw_only=True):
    """All candidates of a picture or of a part of it."""

    discs: list[Disc] = field(default_factory=list)
    refused: list[RefusedDisc] = field(default_factory=list)
    brightness_range: int = 0
    outlines: int = 0  # how many outlines of another shape there are, at all levels of brightness

    def ranked(self) -> list[Disc]:
        """Return the discs, the best first: a whole one comes before any that the border cuts off."""
        return sorted(self.discs, key=lambda each: (not each.truncated, each.evidence), reverse=True)

    @property
    def has_whole(self) -> bool:
        """True if there is a disc that the border does not cut off."""
        return any(not each.truncated for each in self.discs)


def find_doubt(disc: Disc, judged: Judged, lens: Lens, colour_share: float) -> str:
    """Return why it cannot be said that a disc is the one; an empty string if it can."""
    # First the other discs, then the other outlines: both tell that another ellipse may be the one. Without this test
    # another ellipse was taken in 15 to 27 % of cluttered pictures, with it in 1.5 %.
    rival = next((each for each in judged.ranked() if _is_rival(each, disc)), None)
    advice = "name its colour" if colour_share == 1.0 else "look closer"
    if rival is not None:
        return f"ambiguous: 2 discs fit, {_describe_place(disc, lens)} and {_describe_place(rival, lens)}; {advice}"
    # A named colour leaves as many candidates as have it, so the limit falls by the share of the picture with that
    # colour; texture counts as 100 outlines at most, since in rooms a third of the discs were lost to it.
    limit = EVIDENCE_PER_OUTLINE * min(judged.outlines, MAX_OUTLINES) * colour_share
    if disc.evidence < limit:
        return (
            f"ambiguous: {_describe_place(disc, lens)} may be any ellipse among {judged.outlines} outlines: evidence "
            f"{disc.evidence:.0f}, limit {limit:.0f}; {advice}"
        )
    return ""


def _is_rival(other: Disc, disc: Disc) -> bool:
    """Check whether another disc fits as well, elsewhere: a ring has two outlines around one centre."""
    apart_px = float(np.abs(other.edges.ellipse.centre_px - disc.edges.ellipse.centre_px).max())
    # A quarter of the diameter: inner and outer edge of a ring count as one disc.
    elsewhere = apart_px > diameters_px(disc.edges)[0] / 4
    return elsewhere and not other.truncated and other.evidence > RIVAL_SHARE * disc.evidence


def _describe_place(disc: Disc, lens: Lens) -> str:
    x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
    return f"{diameters_px(disc.edges)[0]:.0f} px at {x:.0f}, {y:.0f}"


def colour_share(image: Image, colour: HsvRange | None) -> float:
    """Return about which share of a picture has a colour; 1 without one."""
    if colour is None:
        return 1.0
    thinned = np.ascontiguousarray(image[::COLOUR_STEP, ::COLOUR_STEP])
    # Every eighth pixel each way: a 64th of the picture. 2 % at least, or a rare colour would leave no limit at all.
    share = int(np.count_nonzero(colour.mask(thinned))) / (thinned.shape[0] * thinned.shape[1])
    return max(float(share), MIN_PICTURE_COLOUR_SHARE)


def find_colour_trouble(image: Image, ellipse: Ellipse, lens: Lens, colour: HsvRange) -> Trouble | None:
    """Return why the inside of an ellipse has not a colour; None if it has."""
    # 64 points on four rings up to three quarters of the half axes, bent to where they appear, nearest pixels.
    last = np.array((image.shape[1], image.shape[0])) - 1
    x, y = np.clip(np.rint(lens.bent(INSIDE @ ellipse.half_axes_px + ellipse.centre_px)), 0, last).astype(np.intp).T
    share = int(np.count_nonzero(colour.mask(np.ascontiguousarray(image[y, x][None])))) / len(x)
    if share >= MIN_DISC_COLOUR_SHARE:
        return None
    return Trouble(TESTS, f"has the disc's colour on {share:.0%} of it, limit {MIN_DISC_COLOUR_SHARE:.0%}")


def refuse_shape(outline: Outline, view: View) -> RefusedDisc:
    """Return an outline of another shape as a candidate that is no disc."""
    larger, smaller, _ = outline.ellipse.axes()
    if outline.off_px < math.inf:
        why = f"is no ellipse: its outline lies {outline.off_px / view.scale:.1f} px off one"
    elif outline.fill <= MIN_FILL:
        why = f"is no ellipse: it fills {outline.fill:.0%} of one, limit {MIN_FILL:.0%}"
    else:
        why = f"is {smaller / larger:.2f} times as high as wide, limit {MIN_ASPECT:.2f}"
    return RefusedDisc(
        ellipse=view.in_full(outline.ellipse), is_bright=outline.shape.is_bright, trouble=Trouble(-1, why)
    )


def likeness(refused: RefusedDisc) -> tuple[int, float]:
    """Return the figures of a candidate that are larger the more it is like a disc."""
    return refused.trouble.passed, refused.ellipse.axes()[0]


def list_rejected(judged: Judged, taken: Disc | None, lens: Lens) -> tuple[RejectedCandidate, ...]:
    """Return the other discs, and what is no disc, the most like one first."""
    found = [] if taken is None else [_describe_less_evident(each, taken, lens) for each in judged.ranked()]
    for each in sorted(judged.refused, key=likeness, reverse=True):
        x, y = lens.bent(each.ellipse.centre_px).tolist()
        found.append(RejectedCandidate(centre_px=(x, y), size_px=2 * each.ellipse.axes()[0], reason=each.trouble.text))
    return tuple(found[:MAX_REJECTED])


def _describe_less_evident(disc: Disc, taken: Disc, lens: Lens) -> RejectedCandidate:
    x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
    if disc.truncated:
        reason = "is cut off by the border"
    else:
        reason = f"stands out less than the disc that was taken: {disc.evidence:.0f}, limit {taken.evidence:.0f}"
    return RejectedCandidate(centre_px=(x, y), size_px=diameters_px(disc.edges)[0], reason=reason)
