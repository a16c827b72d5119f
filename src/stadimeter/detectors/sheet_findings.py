"""What a search for a sheet found, and what it refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points, RejectedCandidate
from stadimeter.detectors.quad_shape import longest_sides_px, polygon_area

Which = NDArray[np.bool_]

MOST_REFUSED = 8
REFUSED_OF_A_KIND = 3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Candidate:
    """An outline that looks like the sheet.

    Attributes:
        corners_px: Its corners, clockwise on the screen, shape ``(4, 2)``.
        corner_sigma_px: Standard deviation of their coordinates.
        is_brighter: Whether it is brighter than what is around it.
        quality: From 0, barely a candidate, to 1, as it should look.
        chance: The share of outlines of any kind that would fit the sheet as well; 0 where it is not known.
    """

    corners_px: Points
    corner_sigma_px: float
    is_brighter: bool
    quality: float
    chance: float = 0.0

    @property
    def score(self) -> float:
        """The larger and the more like the sheet, the better."""
        return self.quality * math.sqrt(polygon_area(self.corners_px))


@dataclass(slots=True, kw_only=True)
class Findings:
    """What a search found.

    Attributes:
        best: The outline that looks most like the sheet; None if none is one.
        cut_off: The largest outline that could be one and is cut off by the border, if there is no whole one.
        refused: What else was looked at.
        calm: How many times as easily an outline may fit by chance, because there are few.
    """

    best: Candidate | None = None
    cut_off: Candidate | None = None
    refused: list[tuple[int, RejectedCandidate]] = field(default_factory=list)
    calm: float = 1.0

    def refuse(self, stage: int, corners: Points, failing: Which, why: Callable[[int], str]) -> None:
        """Note the largest of the candidates that fail a test.

        Args:
            stage: How many tests came before; what passed more of them is more like the sheet.
            corners: The candidates' corners, shape ``(c, 4, 2)``.
            failing: Which of them fail.
            why: Says for one of them why.
        """
        numbers = np.nonzero(failing)[0]
        if not len(numbers):
            return
        sizes = longest_sides_px(corners[numbers])
        for which in np.argsort(-sizes, kind="stable")[:REFUSED_OF_A_KIND].tolist():
            number = int(numbers[which])
            x_px, y_px = corners[number].mean(axis=0).tolist()
            refused = RejectedCandidate(centre_px=(x_px, y_px), size_px=float(sizes[which]), reason=why(number))
            self.refused.append((stage, refused))

    def most_like_px(self, stage: int) -> float:
        """Return the size of the largest candidate that was refused at a stage or later; 0 if none was."""
        return max((refused.size_px for at, refused in self.refused if at >= stage), default=0.0)

    def rejected(self) -> tuple[RejectedCandidate, ...]:
        """Return what was refused, the most like the sheet first, each place once."""
        kept: list[RejectedCandidate] = []
        places = [] if self.best is None else [tuple(self.best.corners_px.mean(axis=0).tolist())]
        for _, each in sorted(self.refused, key=lambda item: (-item[0], -item[1].size_px)):
            if all(math.dist(each.centre_px, place) > 0.1 * each.size_px + 2 for place in places):
                kept.append(each)
                places.append(each.centre_px)
        return tuple(kept[:MOST_REFUSED])
