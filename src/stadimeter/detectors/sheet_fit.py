"""Whether outlines are pictures of the sheet: of a rectangle of its shape, through the lens."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.ranging.flat import SheetSize
from stadimeter.ranging.rectangle_fit import rectangle_fit

Values = NDArray[np.float64]

FOCAL_LENGTHS = (0.5, 0.65, 0.85, 1.1, 1.5, 2.2, 3.5)
"""What is tried while the lens is not known, in lengths of the picture's longer side: from wide-angle to telephoto."""

UNKNOWN_SIDES = (0.5, 0.65, 0.8, 1.0, 1.25, 1.55, 2.0)
"""What is tried for the side that is not named, in lengths of what the options say of it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SheetFit:
    """How well outlines fit the sheet.

    Attributes:
        misfit_px: How far their corners are from where a sheet would have them, root mean square, shape ``(c,)``.
        chance_per_square: What the square of a misfit in pixels is multiplied by to give the share of any outlines that
            fit as well, shape ``(c,)``; 0 where it is not known, without the lens or with only one side known.
    """

    misfit_px: Values
    chance_per_square: Values


class SheetShape:
    """What pictures of the sheet look like.

    Args:
        size: The sheet's size.
        lens: The camera model at the picture's resolution; None if it is not known.
        picture: Width and height of the picture.
    """

    def __init__(self, size: SheetSize, lens: CameraModel | None, picture: tuple[int, int]) -> None:
        aspect = size.width_m / size.height_m
        one_side = size.known_side != "auto"
        self._aspects = tuple(aspect * each for each in UNKNOWN_SIDES) if one_side else (aspect,)
        long_px = float(max(picture))
        self._lenses = (
            tuple(CameraModel.with_focal_length(each * long_px, *picture) for each in FOCAL_LENGTHS)
            if lens is None
            else (lens,)
        )
        self._tells_chance = lens is not None and not one_side

    def fit(self, corners_px: Points) -> SheetFit:
        """Compare outlines with the sheet.

        Args:
            corners_px: Their corners in order around each, shape ``(c, 4, 2)``.

        Returns:
            How well they fit; through the best of the lenses and shapes that are possible.
        """
        tried = [self._through(lens, corners_px) for lens in self._lenses]
        if len(tried) == 1:
            return tried[0]
        return SheetFit(
            misfit_px=np.min([each.misfit_px for each in tried], axis=0), chance_per_square=np.zeros(len(corners_px))
        )

    def _through(self, lens: CameraModel, corners_px: Points) -> SheetFit:
        focal_px = math.sqrt(lens.fx_px * lens.fy_px)
        directions = lens.directions(corners_px.reshape(-1, 2)).reshape(-1, 4, 2)
        fits = [rectangle_fit(directions, aspect) for aspect in self._aspects]
        chance = fits[0].chance_per_square / focal_px**2
        return SheetFit(
            misfit_px=np.min([each.misfit for each in fits], axis=0) * focal_px,
            chance_per_square=chance if self._tells_chance else np.zeros_like(chance),
        )
