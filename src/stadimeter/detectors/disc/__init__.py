"""The disc detector: a flat circle of one brightness, such as a sticker, a lid or a printed dot, at any tilt.

A circle that does not face the camera appears as an ellipse. Another ellipse of even brightness, such as another lid,
looks the same as the disc: the one that stands out most is taken, see `stadimeter.detectors.disc.edges.prominence`. A
disc that is partly hidden, or touches what is as bright, is looked for where there is no whole one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field

from stadimeter.config.plugins import DriverContext, Exercise, Options, Plugin
from stadimeter.config.units import Length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.detectors.disc.edges import (
    ROUGHLY,
    THOROUGHLY,
    Effort,
    EllipseEdges,
    Trouble,
    diameters_px,
    measure_ellipse,
    prominence,
    quality,
    trouble_with,
)
from stadimeter.detectors.disc.ellipse import Ellipse, Lens
from stadimeter.detectors.disc.profiles import EdgePicture
from stadimeter.detectors.disc.search import (
    LEAST_ASPECT,
    LEAST_FILL,
    LEAST_RANGE,
    Outline,
    View,
    find_outlines,
    find_partly_hidden,
    largest,
)
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.region import Region, touches_border
from stadimeter.ranging.flat import DiscShape

MOST_MEASURED = 12
"""Number of candidates whose outlines are measured: the most promising."""

MOST_REJECTED = 8
BORDER_PX = 1.5
"""A disc nearer to the border of the picture than this may be cut off."""

LEAST_SEARCH_PX, LEAST_SEARCH_SHARE = 6.0, 0.75
"""The least size of outlines: in pixels of the reduced picture, and as a share of the least diameter of a disc. Parted
at another level than half way, a disc is smaller."""

REACH_PX, REACH_SHARE = 2.5, 0.04
"""Reach of the search for an outline around a candidate: in pixels of the reduced picture, and as a share of its
size."""

REACH_AGAIN_PX = 2.5
"""Reach around where it was measured roughly."""

AROUND_SIZES, AROUND_SIGMAS, AROUND_PX = 0.75, 4.0, 8.0
"""Reach of the search around a prediction: in sizes, standard deviations and pixels."""

OUTLINE_POINTS = 64
SIGMA_FACTOR = 1.4
SIGMA_FLOOR_PX = 0.01
SIGMA_BEND = 1.0
SIGMA_BLUR, SIGMA_MUCH_BLUR = 0.0025, 0.03
SIGMA_CURVE = 0.05
"""The standard deviation of the larger diameter is ``hypot(1.4 s, 0.01, b, min(0.0025 e⁴, 0.03 e), 0.05 e² k)`` in px:
s is what follows from the scatter of the edges if each errs on its own, b how far the outline is from an ellipse, e the
blur of the edge, and k the curvature where the outline bends most.

Fitted on rendered discs of 24 to 240 px, tilted by 0 to 60 degrees: clean, before clutter, with noise, blurred, moved
by 4 to 10 px, in JPEG. Under JPEG it promises too much: there the diameter comes out 0.03 px too small in all frames.
"""

Shade = Literal["bright", "dark", "any"]


class DiscOptions(Options):
    """What a ``[targets.…]`` table with ``driver = "disc"`` may hold."""

    diameter: Length
    """The disc's diameter, such as ``"12 cm"``."""
    tolerance: Length | None = None
    """One standard deviation of its diameter, such as ``"1 mm"``."""
    min_diameter_px: Annotated[float, Field(ge=8)] = 12.0
    """Discs whose larger diameter in the picture is smaller than this are not accepted."""
    shade: Shade = "any"
    """Whether it is ``bright`` on something darker, ``dark`` on something brighter, or ``any`` of these."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Refused:
    """A candidate that is no disc, as an ellipse in the picture."""

    ellipse: Ellipse
    is_bright: bool
    trouble: Trouble

    @property
    def described(self) -> str:
        """Which candidate it is, and why it is none."""
        larger, smaller, _ = self.ellipse.axes()
        shade = "bright" if self.is_bright else "dark"
        return f"{shade} outline, {2 * larger:.0f}x{2 * smaller:.0f} px, {self.trouble.text}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Disc:
    """A candidate that is a disc, without the lens's distortion."""

    edges: EllipseEdges
    is_bright: bool
    prominence: float
    truncated: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key, greater for a better one: a whole one comes before any that the border cuts off."""
        return not self.truncated, self.prominence


@dataclass(slots=True, kw_only=True)
class _Judged:
    """All candidates of a picture or of a part of it."""

    discs: list[_Disc] = field(default_factory=list)
    refused: list[_Refused] = field(default_factory=list)
    brightness_range: int = 0

    def ranked(self) -> list[_Disc]:
        """Return the discs, the best first."""
        return sorted(self.discs, key=lambda each: each.rank, reverse=True)

    @property
    def has_whole(self) -> bool:
        """Whether there is a disc that the border does not cut off."""
        return any(not each.truncated for each in self.discs)


class DiscDetector:
    """Finds a flat circle of one brightness that differs from all that is around it."""

    def __init__(self, name: str, options: DiscOptions) -> None:
        self._name = name
        sigma_m = options.tolerance or 0.0
        self._size = DiscShape(diameter_m=options.diameter, relative_sigma=sigma_m / options.diameter)
        self._least_px = options.min_diameter_px
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
        through = Lens(camera=lens)
        near = None if prediction is None else self._near(frame, through, prediction)
        return near or self._anywhere(frame, through)

    def _near(self, frame: Frame, lens: Lens, prediction: Prediction) -> Detection | None:
        """Return the whole disc most like the prediction; None if there is none around it."""
        expected = np.array(prediction.centre_px)
        reach = AROUND_SIZES * prediction.size_px + AROUND_SIGMAS * prediction.sigma_px + AROUND_PX
        region = Region.around(prediction.centre_px, reach, frame.image)
        if region is None:
            return None
        judged = self._judge_all(frame, View.of(frame.image, region), lens)

        def unlike_px(disc: _Disc) -> float:
            apart_px = np.abs(lens.bent(disc.edges.ellipse.centre_px) - expected).max()
            return float(max(apart_px, abs(diameters_px(disc.edges)[0] - prediction.size_px)))

        whole = sorted((each for each in judged.discs if not each.truncated), key=unlike_px)
        found = self._first_of(whole, frame, lens, judged)
        return None if found is None or found.truncated else self._found(found, judged, lens)

    def _anywhere(self, frame: Frame, lens: Lens) -> Detection:
        judged = self._judge_all(frame, View.of(frame.image, Region.whole(frame.image)), lens)
        found = self._first_of(judged.ranked(), frame, lens, judged)
        return self._not_found(judged, lens) if found is None else self._found(found, judged, lens)

    def _first_of(self, discs: Iterable[_Disc], frame: Frame, lens: Lens, judged: _Judged) -> _Disc | None:
        """Return the first disc that is one still when it is measured thoroughly."""
        for disc in discs:
            judged.discs.remove(disc)
            exact = self._measured(frame, lens, disc.edges.ellipse, REACH_AGAIN_PX, disc.is_bright, THOROUGHLY)
            if isinstance(exact, _Disc):
                return exact
            judged.refused.append(exact)
        return None

    def _judge_all(self, frame: Frame, view: View, lens: Lens) -> _Judged:
        """Judge what is elliptical in a view; if none of that is a whole disc, then what is partly hidden too."""
        least_px = max(LEAST_SEARCH_PX, LEAST_SEARCH_SHARE * self._least_px * view.scale)
        found = find_outlines(view.grey, least_px, bright=self._bright, dark=self._dark)
        judged = _Judged(brightness_range=found.brightness_range)
        refused = self._judge(frame, view, lens, found.ellipses, judged)
        others = largest(found.others, MOST_REJECTED)
        if not judged.has_whole:
            height, width = view.grey.shape
            self._judge(frame, view, lens, find_partly_hidden([*refused, *others], (height, width)), judged)
        judged.refused += [_no_ellipse(each, view) for each in others]
        return judged

    def _judge(
        self, frame: Frame, view: View, lens: Lens, outlines: Iterable[Outline], judged: _Judged
    ) -> list[Outline]:
        """Measure outlines roughly, and return those that are no discs."""
        refused = []
        for outline in list(outlines)[:MOST_MEASURED]:
            start = lens.straightened(view.in_full(outline.ellipse))
            if start is None:
                continue
            reach_px = REACH_PX / view.scale + REACH_SHARE * outline.size_px / view.scale
            result = self._measured(frame, lens, start, reach_px, outline.shape.is_bright, ROUGHLY)
            if isinstance(result, _Disc):
                judged.discs.append(result)
            else:
                judged.refused.append(result)
                refused.append(outline)
        return refused

    def _measured(
        self, frame: Frame, lens: Lens, start: Ellipse, reach_px: float, is_bright: bool, effort: Effort
    ) -> _Disc | _Refused:
        edges = measure_ellipse(
            EdgePicture(image=frame.image, light=lens.light, bend=lens.bend),
            start,
            is_bright=is_bright,
            reach_px=reach_px,
            edge_bias_px=lens.camera.edge_bias_px if lens.camera else 0.0,
            effort=effort,
        )
        if edges is None:
            trouble = Trouble(0, f"has no elliptical edge within {reach_px:.1f} px")
            return _Refused(ellipse=start, is_bright=is_bright, trouble=trouble)
        failed = trouble_with(edges, self._least_px, lens.light)
        if failed is not None:
            return _Refused(ellipse=start, is_bright=is_bright, trouble=failed)
        rim = lens.bent(edges.ellipse.rim(OUTLINE_POINTS).points_px)
        return _Disc(
            edges=edges,
            is_bright=is_bright,
            prominence=prominence(edges, lens.light),
            truncated=touches_border(rim, frame.width_px, frame.height_px, BORDER_PX),
        )

    def _found(self, disc: _Disc, judged: _Judged, lens: Lens) -> Detection:
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
            size_sigma_px=_size_sigma_px(disc.edges),
            quality=quality(disc.edges),
            rejected=_rejected(judged, disc, lens),
        )

    def _not_found(self, judged: _Judged, lens: Lens) -> Detection:
        if judged.brightness_range < LEAST_RANGE:
            reason = f"the picture is even: its levels differ by {judged.brightness_range}, limit {LEAST_RANGE}"
        elif judged.refused:
            reason = max(judged.refused, key=_likeness).described
        else:
            reason = f"no outline of at least {self._least_px:g} px"
        return Detection(
            target=self._name,
            status=DetectionStatus.NOT_FOUND,
            reason=reason,
            rejected=_rejected(judged, None, lens),
        )


def _no_ellipse(outline: Outline, view: View) -> _Refused:
    larger, smaller, _ = outline.ellipse.axes()
    if outline.off_px < math.inf:
        why = f"is no ellipse: its outline lies {outline.off_px / view.scale:.1f} px off one"
    elif outline.fill <= LEAST_FILL:
        why = f"is no ellipse: it fills {outline.fill:.0%} of one, limit {LEAST_FILL:.0%}"
    else:
        why = f"is {smaller / larger:.2f} times as high as wide, limit {LEAST_ASPECT:.2f}"
    return _Refused(ellipse=view.in_full(outline.ellipse), is_bright=outline.shape.is_bright, trouble=Trouble(-1, why))


def _likeness(refused: _Refused) -> tuple[int, float]:
    """Return what a candidate has more of the more it is like a disc."""
    return refused.trouble.passed, refused.ellipse.axes()[0]


def _rejected(judged: _Judged, taken: _Disc | None, lens: Lens) -> tuple[RejectedCandidate, ...]:
    """Return the other discs, and what is no disc, the most like one first."""
    found = [] if taken is None else [_less_prominent(each, taken, lens) for each in judged.ranked()]
    for each in sorted(judged.refused, key=_likeness, reverse=True):
        x, y = lens.bent(each.ellipse.centre_px).tolist()
        found.append(RejectedCandidate(centre_px=(x, y), size_px=2 * each.ellipse.axes()[0], reason=each.trouble.text))
    return tuple(found[:MOST_REJECTED])


def _less_prominent(disc: _Disc, taken: _Disc, lens: Lens) -> RejectedCandidate:
    x, y = lens.bent(disc.edges.ellipse.centre_px).tolist()
    if disc.truncated:
        reason = "is cut off by the border"
    else:
        reason = f"stands out less than the disc that was taken: {disc.prominence:.0f}, limit {taken.prominence:.0f}"
    return RejectedCandidate(centre_px=(x, y), size_px=diameters_px(disc.edges)[0], reason=reason)


def _size_sigma_px(edges: EllipseEdges) -> float:
    larger, smaller, _ = edges.ellipse.axes()
    return math.hypot(
        SIGMA_FACTOR * edges.sigma_px,
        SIGMA_FLOOR_PX,
        SIGMA_BEND * edges.bend_px,
        min(SIGMA_BLUR * edges.edge_px**4, SIGMA_MUCH_BLUR * edges.edge_px),
        SIGMA_CURVE * edges.edge_px**2 * larger / smaller**2,
    )


def _build(options: DiscOptions, context: DriverContext) -> DiscDetector:
    return DiscDetector(context.name, options)


def _exercise() -> Exercise:
    """Return a bright disc of 80 px on something dark."""
    finer = 8
    large = np.full((110 * finer, 110 * finer, 3), 60, np.uint8)
    cv2.circle(large, (55 * finer, 55 * finer), 40 * finer, (225, 225, 225), cv2.FILLED)
    patch = np.asarray(cv2.resize(large, (110, 110), interpolation=cv2.INTER_AREA), np.uint8)
    return Exercise(options={"diameter": "8 cm"}, patch=patch)


PLUGIN = Plugin(DiscOptions, _build, exercise=_exercise)
