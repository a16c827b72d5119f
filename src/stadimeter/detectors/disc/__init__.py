"""The disc detector: a flat circle of one brightness, such as a sticker, a lid or a printed dot, at any tilt.

A circle that does not face the camera appears as an ellipse. Another ellipse of even brightness, such as another lid,
looks the same as the disc: the one that most speaks for is taken, unless others do as much, see
`stadimeter.detectors.disc.search`. A
disc that is partly hidden, or touches what is as bright, is looked for where there is no whole one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length, Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, RejectedCandidate
from stadimeter.core.drawing import Circle, Drawing
from stadimeter.core.frame import Frame
from stadimeter.detectors.disc.edges import (
    ROUGHLY,
    THOROUGHLY,
    EdgePicture,
    Effort,
    Ellipse,
    EllipseEdges,
    Lens,
    Trouble,
    diameters_px,
    evidence,
    find_trouble,
    measure_ellipse,
    quality,
)
from stadimeter.detectors.disc.search import (
    MAX_REJECTED,
    MIN_RANGE,
    Disc,
    Judged,
    Outline,
    RefusedDisc,
    View,
    colour_share,
    find_colour_trouble,
    find_doubt,
    find_outlines,
    find_partly_hidden,
    likeness,
    list_rejected,
    pick_largest,
    refuse_shape,
)
from stadimeter.detectors.hsv import HsvRangeText
from stadimeter.detectors.protocol import ONE_OF_A_KIND, check_image
from stadimeter.detectors.sampling import Region, touches_border
from stadimeter.ranging.flat import DiscShape

# Number of candidates whose outlines are measured: the most promising.
MAX_MEASURED = 12

# A disc nearer to the border of the picture than this may be cut off.
BORDER_PX = 1.5

# The least size of outlines: in pixels of the reduced picture, and as a share of the least diameter of a disc. Parted
# at another level than half way, a disc is smaller.
MIN_SEARCH_PX, MIN_SEARCH_SHARE = 6.0, 0.75

# Reach of the search for an outline around a candidate: in pixels of the reduced picture, and as a share of its
# size.
REACH_PX, REACH_SHARE = 2.5, 0.04

# Reach around where it was measured roughly.
REACH_AGAIN_PX = 2.5

# Reach of the search around a prediction: in sizes and pixels.
AROUND_SIZES, AROUND_PX = 0.75, 8.0

# The standard deviation of the larger diameter is the root of the sum of the squares of ``1.4 s``, ``0.004``, ``0.6
# b``, ``min(0.008 e⁴, 0.03 e)``, ``0.05 e² k`` and q in px, times ``1 + 2.5 h``: s is what follows from the scatter of
# the edges if each errs on its own, b how far the outline is from an ellipse, e the blur of the edge, k the curvature
# where the outline bends most, q 0.035 where colour is stored at a lower resolution, as in JPEG and MJPEG, which makes
# a white disc 0.02 px too small in all frames, and h the share of the outline that is hidden, where the rest is carried
# on.
#
# Fitted on rendered discs of 24 to 240 px, tilted by 0 to 60 degrees: clean, before clutter, with noise, moved by 3 and
# 6 px, in JPEG, hidden by 20 %.
OUTLINE_POINTS = 64
SIGMA_FACTOR = 1.4
SIGMA_FLOOR_PX = 0.004
SIGMA_BEND = 0.6
SIGMA_BLUR, SIGMA_MUCH_BLUR = 0.008, 0.03
SIGMA_CURVE = 0.05
SIGMA_COMPRESSED_PX = 0.035
SIGMA_HIDDEN = 2.5

# White around a printed disc, as a share of its diameter.
PRINTED_RIM = 0.1

Shade = Literal["bright", "dark", "any"]


class DiscOptions(DriverOptions):
    """The options of a flat disc of one brightness."""

    written_elsewhere: ClassVar[dict[str, str]] = ONE_OF_A_KIND

    diameter: Length
    """The disc's diameter, such as ``"12 cm"``."""
    tolerance: Tolerance | None = None
    """One standard deviation of its diameter, such as ``"1 mm"``."""
    min_diameter_px: Annotated[float, Field(ge=8)] = 12.0
    """Discs whose larger diameter in the picture is smaller than this are not accepted."""
    shade: Shade = "any"
    """Whether it is ``bright`` on something darker, ``dark`` on something brighter, or ``any`` of these."""
    hsv: HsvRangeText | None = None
    """Its colours, lower and upper limit of hue, saturation and value: ``"0,0,150:179,60,255"`` is white. With it a
    disc is found among many other things, any of which may be an ellipse."""

    def build(self, context: DriverContext) -> DiscDetector:
        """Return the detector."""
        return DiscDetector(context.name, self)

    def draw(self) -> Drawing:
        """Return a black disc on white."""
        side_m = (1 + 2 * PRINTED_RIM) * self.diameter
        return Drawing(side_m, side_m, (Circle(side_m / 2, side_m / 2, self.diameter / 2),))


class DiscDetector:
    """Finds a flat circle of one brightness that differs from all that is around it."""

    def __init__(self, name: str, options: DiscOptions) -> None:
        self._name = name
        sigma_m = options.tolerance or 0.0
        self._size = DiscShape(diameter_m=options.diameter, relative_sigma=sigma_m / options.diameter)
        self._min_px = options.min_diameter_px
        self._colour = options.hsv
        self._bright, self._dark = options.shade != "dark", options.shade != "bright"

    @property
    def target_shape(self) -> DiscShape:
        """The disc's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the disc: the one most like the prediction, or else the one that stands out most.

        Its width is its larger diameter and its height its smaller one, however it is turned.
        """
        check_image(frame)
        picture = EdgePicture(image=frame.image, lens=Lens(camera=lens))
        near = None if prediction is None else self._search_near(picture, prediction)
        return near or self._search_anywhere(picture)

    def _search_near(self, picture: EdgePicture, prediction: Prediction) -> Detection | None:
        """Return the whole disc most like the prediction; None if there is none around it."""
        # Largest difference along an axis in place, or difference in size, in pixels; the most similar whole ellipse is
        # measured first. One at the border goes to the search of the whole picture.
        expected = np.array(prediction.centre_px)
        region = Region.expected(prediction, picture.image, sizes=AROUND_SIZES, margin_px=AROUND_PX)
        if region is None:
            return None
        lens, judged = picture.lens, self.judge_all(picture, region)

        def unlike_px(disc: Disc) -> float:
            apart_px = np.abs(lens.bent(disc.edges.ellipse.centre_px) - expected).max()
            return float(max(apart_px, abs(diameters_px(disc.edges)[0] - prediction.size_px)))

        whole = sorted((each for each in judged.discs if not each.truncated), key=unlike_px)
        found = self._pick_first(whole, picture, judged)
        return None if found is None or found.truncated else self._report_found(found, judged, lens)

    def _search_anywhere(self, picture: EdgePicture) -> Detection:
        lens, judged = picture.lens, self.judge_all(picture, Region.whole(picture.image))
        found = self._pick_first(judged.ranked(), picture, judged)
        if found is None:
            return self._report_not_found(judged, lens)
        why = find_doubt(found, judged, lens, colour_share(picture.image, self._colour))
        return self._report_ambiguous(found, why, judged, lens) if why else self._report_found(found, judged, lens)

    def _pick_first(self, discs: Iterable[Disc], picture: EdgePicture, judged: Judged) -> Disc | None:
        """Return the first disc that is one still when it is measured thoroughly."""
        for disc in discs:
            judged.discs.remove(disc)
            exact = self.measure_exactly(picture, disc)
            if isinstance(exact, Disc):
                return exact
            judged.refused.append(exact)
        return None

    def measure_exactly(self, picture: EdgePicture, disc: Disc) -> Disc | RefusedDisc:
        """Measure a disc thoroughly."""
        # Two efforts: 48 lines and 4 looks tell which ellipses may be discs; only the one that is taken is worth
        # 144 lines and a hundredth of a pixel.
        return self._measure(picture, disc.edges.ellipse, REACH_AGAIN_PX, disc.is_bright, THOROUGHLY)

    def judge_all(self, picture: EdgePicture, region: Region) -> Judged:
        """Judge what is elliptical in a region; if none of that is a whole disc, then what is partly hidden too."""
        view = View.of(picture.image, region)
        min_px = max(MIN_SEARCH_PX, MIN_SEARCH_SHARE * self._min_px * view.scale)
        found = find_outlines(view.grey, min_px, bright=self._bright, dark=self._dark)
        judged = Judged(brightness_range=found.brightness_range, outlines=len(found.others))
        refused = self._judge(picture, view, found.ellipses, judged)
        others = pick_largest(found.others, MAX_REJECTED)
        # Pieces of outlines are tried only where no whole disc is: they cost a fit for each, and chance makes ellipses
        # of them.
        if not judged.has_whole:
            height, width = view.grey.shape
            self._judge(picture, view, find_partly_hidden([*refused, *others], (height, width)), judged)
        judged.refused += [refuse_shape(each, view) for each in others]
        return judged

    def _judge(self, picture: EdgePicture, view: View, outlines: Iterable[Outline], judged: Judged) -> list[Outline]:
        """Measure outlines roughly, and return those that are no discs."""
        refused = []
        for outline in list(outlines)[:MAX_MEASURED]:
            # From here on ellipses are in pixels of the full picture with the lens's distortion undone, where a
            # circle's outline is an ellipse exactly.
            start = picture.lens.straighten(view.in_full(outline.ellipse))
            if start is None:
                continue
            # A pixel of the reduced picture is 1 / scale of the full one; the outline was found to within 2.5 of them
            # and 4 % of the size.
            reach_px = REACH_PX / view.scale + REACH_SHARE * outline.size_px / view.scale
            result = self._measure(picture, start, reach_px, outline.shape.is_bright, ROUGHLY)
            if isinstance(result, Disc):
                judged.discs.append(result)
            else:
                judged.refused.append(result)
                refused.append(outline)
        return refused

    def _measure(
        self, picture: EdgePicture, start: Ellipse, reach_px: float, is_bright: bool, effort: Effort
    ) -> Disc | RefusedDisc:
        lens = picture.lens
        edges = measure_ellipse(picture, start, is_bright=is_bright, reach_px=reach_px, effort=effort)
        if edges is None:
            trouble = Trouble(0, f"has no elliptical edge within {reach_px:.1f} px")
            return RefusedDisc(ellipse=start, is_bright=is_bright, trouble=trouble)
        failed = find_trouble(edges, self._min_px, lens.light)
        if failed is None and self._colour is not None:
            failed = find_colour_trouble(picture.image, edges.ellipse, lens, self._colour)
        if failed is not None:
            return RefusedDisc(ellipse=start, is_bright=is_bright, trouble=failed)
        # Back to where the picture shows it: the border cuts off what is seen there.
        rim = lens.bent(edges.ellipse.rim(OUTLINE_POINTS).points_px)
        return Disc(
            edges=edges,
            is_bright=is_bright,
            evidence=evidence(edges, lens.light),
            truncated=touches_border(rim, picture.image.shape, BORDER_PX),
        )

    def _report_found(self, disc: Disc, judged: Judged, lens: Lens) -> Detection:
        ellipse = disc.edges.ellipse
        larger_px, smaller_px = diameters_px(disc.edges)
        x, y = lens.bent(ellipse.centre_px)
        what = f"the disc, {larger_px:.0f}x{smaller_px:.0f} px, is cut off by the border"
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if disc.truncated else DetectionStatus.FOUND,
            reason=what if disc.truncated else "",
            outline_px=lens.bent(ellipse.rim(OUTLINE_POINTS).points_px),
            centre_px=(float(x), float(y)),
            width_px=larger_px,
            height_px=smaller_px,
            size_sigma_px=_size_sigma_px(disc.edges, compressed=lens.is_compressed),
            quality=quality(disc.edges),
            rejected=list_rejected(judged, disc, lens),
        )

    def _report_ambiguous(self, disc: Disc, why: str, judged: Judged, lens: Lens) -> Detection:
        """Return that the disc may be in the picture, but which ellipse it is, or whether it is one, is not known."""
        x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
        size_px = diameters_px(disc.edges)[0]
        fits = RejectedCandidate(centre_px=(x, y), size_px=size_px, reason="fits, but others may as well")
        others = list_rejected(judged, disc, lens)
        return Detection(
            target=self._name, status=DetectionStatus.NOT_FOUND, reason=why, rejected=(fits, *others)[:MAX_REJECTED]
        )

    def _report_not_found(self, judged: Judged, lens: Lens) -> Detection:
        if judged.brightness_range < MIN_RANGE:
            reason = f"the picture is even: its levels differ by {judged.brightness_range}, limit {MIN_RANGE}"
        elif judged.refused:
            reason = max(judged.refused, key=likeness).described
        else:
            reason = f"no outline of at least {self._min_px:g} px"
        return Detection(
            target=self._name,
            status=DetectionStatus.NOT_FOUND,
            reason=reason,
            rejected=list_rejected(judged, None, lens),
        )


def _size_sigma_px(edges: EllipseEdges, *, compressed: bool) -> float:
    # Independent causes, so their squares add up. The curvature is largest at the ends of the longer axis: a / b², with
    # a and b the half axes. With a part of the outline hidden the rest is carried on: discs hidden by a fifth were in
    # their 95 % interval in 79 % of the pictures without the last factor, in 94 % with it.
    larger, smaller, _ = edges.ellipse.axes()
    return (1 + SIGMA_HIDDEN * (1 - edges.support)) * math.hypot(
        SIGMA_FACTOR * edges.sigma_px,
        SIGMA_FLOOR_PX,
        SIGMA_BEND * edges.bend_px,
        min(SIGMA_BLUR * edges.edge_px**4, SIGMA_MUCH_BLUR * edges.edge_px),
        SIGMA_CURVE * edges.edge_px**2 * larger / smaller**2,
        SIGMA_COMPRESSED_PX * compressed,
    )
