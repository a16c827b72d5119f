"""The circles detector: three equal discs whose centres are equally far apart, as one target.

The discs are those of `stadimeter.detectors.disc`. Three of them are the target where the triangle of their centres,
seen as the ellipses say that the plane is seen, has the proportions that are known: among other round things a single
disc is mistaken for another, three that fit so are hardly ever there by chance.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length, Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.disc import (
    AROUND_PX,
    BORDER_PX,
    OUTLINE_POINTS,
    SIGMA_HIDDEN,
    DiscDetector,
    DiscOptions,
    Shade,
)
from stadimeter.detectors.disc.edges import BEND_PARTS, THOROUGHLY, EdgePicture, Lens, quality, turns
from stadimeter.detectors.disc.search import Disc, Judged, list_rejected
from stadimeter.detectors.hsv import HsvRangeText
from stadimeter.detectors.protocol import ONE_OF_A_KIND, check_image
from stadimeter.detectors.sampling import Region, touches_border
from stadimeter.ranging.flat import CORNERS, CirclesShape

# By how much each side of the triangle, measured in diameters of its two discs, may differ from what is known, as a
# share; and how far another triangle must be behind the best one, which is ambiguous otherwise.
MAX_OFF, MIN_BEHIND = 0.15, 0.03

# Discs that nearly touch are not told apart: the largest diameter as a share of the spacing.
MAX_DIAMETER_SHARE = 0.8

# Reach of the search around a prediction, in spacings.
AROUND_SPACINGS = 1.5

SIXTH = math.pi / 3


class CirclesOptions(DriverOptions):
    """The options of three equal discs at the corners of a triangle with equal sides: more exact than one disc."""

    written_elsewhere: ClassVar[dict[str, str]] = ONE_OF_A_KIND

    diameter: Length
    """The diameter of each disc, such as ``"5 cm"``; a few percent off do not matter."""
    spacing: Length
    """How far apart any two of their centres are, such as ``"10 cm"``: the distance is as right as this."""
    tolerance: Tolerance | None = None
    """One standard deviation of the spacing, such as ``"0.2 mm"``."""
    min_diameter_px: Annotated[float, Field(ge=8)] = 12.0
    """Discs whose larger diameter in the picture is smaller than this are not accepted."""
    shade: Shade = "any"
    """Whether they are ``bright`` on something darker, ``dark`` on something brighter, or ``any`` of these."""
    hsv: HsvRangeText | None = None
    """Their colours, lower and upper limit of hue, saturation and value."""

    @model_validator(mode="after")
    def _are_apart(self) -> CirclesOptions:
        if self.diameter > MAX_DIAMETER_SHARE * self.spacing:
            raise ValueError(
                f"discs of {self.diameter:g} m whose centres are {self.spacing:g} m apart are too near to each other: "
                f"the diameter may be {MAX_DIAMETER_SHARE:.0%} of the spacing; make them smaller"
            )
        return self

    def build(self, context: DriverContext) -> CirclesDetector:
        """Return the detector."""
        return CirclesDetector(context.name, self)


class Triangle(NamedTuple):
    """Three discs that may be the target."""

    discs: tuple[Disc, ...]
    off: float  # the largest difference of a side from what is known, as a share

    @property
    def centre_px(self) -> Points:
        """Its middle, without the lens's distortion."""
        return np.asarray(np.mean([each.edges.ellipse.centre_px for each in self.discs], axis=0))


class CirclesDetector:
    """Finds three equal discs at the corners of an equilateral triangle."""

    def __init__(self, name: str, options: CirclesOptions) -> None:
        self._name = name
        self._size = CirclesShape(
            diameter_m=options.diameter,
            spacing_m=options.spacing,
            relative_sigma=(options.tolerance or 0.0) / options.spacing,
        )
        each = {key: getattr(options, key) for key in ("diameter", "min_diameter_px", "shade", "hsv")}
        self._discs = DiscDetector(name, DiscOptions.model_construct(**each))

    @property
    def target_shape(self) -> CirclesShape:
        """Spacing and diameter."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the three discs: those nearest to the prediction, or else the only ones that fit."""
        check_image(frame)
        picture = EdgePicture(image=frame.image, lens=Lens(camera=lens))
        near = None if prediction is None else self._search_near(picture, prediction)
        return near or self._search_anywhere(picture)

    def _search_near(self, picture: EdgePicture, prediction: Prediction) -> Detection | None:
        region = Region.expected(prediction, picture.image, sizes=AROUND_SPACINGS, margin_px=AROUND_PX)
        if region is None:
            return None
        expected, judged = np.array(prediction.centre_px), self._discs.judge_all(picture, region)
        fitting = self._triangles(judged.discs)
        fitting.sort(key=lambda each: float(np.abs(picture.lens.bent(each.centre_px) - expected).max()))
        found = self._report(fitting[0], picture, judged) if fitting else None
        return found if found is not None and found.status is DetectionStatus.FOUND else None

    def _search_anywhere(self, picture: EdgePicture) -> Detection:
        judged = self._discs.judge_all(picture, Region.whole(picture.image))
        fitting = sorted(self._triangles(judged.discs), key=lambda each: each.off)
        if len(fitting) > 1 and fitting[1].off < fitting[0].off + MIN_BEHIND:
            places = [picture.lens.bent(each.centre_px).tolist() for each in fitting[:2]]
            where = " and ".join(f"at {x:.0f}, {y:.0f}" for x, y in places)
            return self._not_found(f"ambiguous: {len(fitting)} triangles of discs fit, {where}", picture, judged)
        if fitting:
            return self._report(fitting[0], picture, judged)
        if self._is_cut_off(picture, judged.discs):
            reason = "one of the three discs is cut off by the border"
            return Detection(target=self._name, status=DetectionStatus.TRUNCATED, reason=reason)
        reason = f"no three of {len(judged.discs)} discs in the picture are as far apart as stated"
        return self._not_found(reason, picture, judged)

    def _triangles(self, discs: list[Disc]) -> list[Triangle]:
        """Return the discs, three by three, whose centres are as far apart as is known."""
        # A disc may have been found from several outlines: what is at one place counts once.
        apart = [one for place, one in enumerate(discs) if not any(_are_one(one, each) for each in discs[:place])]
        alike = [each for each in combinations(apart, 3) if len({disc.is_bright for disc in each}) == 1]
        found = [Triangle(each, max(self._off(*pair) for pair in combinations(each, 2))) for each in alike]
        return [each for each in found if each.off < MAX_OFF]

    def _off(self, one: Disc, other: Disc) -> float:
        """Return by which share the distance of two discs differs from what is known, however they are turned."""
        # Seen through the ellipse half way between them the plane faces the camera, and lengths are in radii.
        across = np.linalg.solve(*_apart(one, other))
        return abs(float(np.linalg.norm(across)) * self._size.diameter_m / (2 * self._size.spacing_m) - 1)

    def _is_cut_off(self, picture: EdgePicture, discs: list[Disc]) -> bool:
        """Check whether the third disc of two that fit is at the border."""
        for one, other in combinations(discs, 2):
            if one.is_bright == other.is_bright and self._off(one, other) < MAX_OFF:
                half_axes, apart_px = _apart(one, other)
                x, y = np.linalg.solve(half_axes, apart_px)
                for sine in (math.sin(SIXTH), -math.sin(SIXTH)):
                    third = half_axes @ (x / 2 - sine * y, sine * x + y / 2) + one.edges.ellipse.centre_px
                    rim = picture.lens.bent(turns(OUTLINE_POINTS) @ half_axes + third)
                    if touches_border(rim, picture.image.shape, BORDER_PX):
                        return True
        return False

    def _report(self, triangle: Triangle, picture: EdgePicture, judged: Judged) -> Detection:
        discs = []
        for disc in triangle.discs:
            exact = self._discs.measure_exactly(picture, disc)
            if not isinstance(exact, Disc):
                return self._not_found(f"one of the three discs is refused: {exact.described}", picture, judged)
            discs.append(exact)
        lens, ellipses = picture.lens, [each.edges.ellipse for each in discs]
        is_cut_off = any(each.truncated for each in discs)
        # The affine map from the triangle to the picture; its singular values are the scales along two directions.
        centres = np.array([each.centre_px for each in ellipses])
        scales = np.linalg.svd(2 * CORNERS.T @ centres, compute_uv=False)
        x, y = lens.bent(centres.mean(axis=0)).tolist()
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if is_cut_off else DetectionStatus.FOUND,
            reason="one of the three discs is cut off by the border" if is_cut_off else "",
            outline_px=np.concatenate([lens.bent(each.rim(OUTLINE_POINTS).points_px) for each in ellipses]),
            centre_px=(x, y),
            width_px=float(scales[0]),
            height_px=float(scales[1]),
            size_sigma_px=math.sqrt(sum(_sigma_px(each) ** 2 for each in discs) / 3),
            quality=min(quality(each.edges) for each in discs),
            rejected=list_rejected(judged, None, lens),
        )

    def _not_found(self, reason: str, picture: EdgePicture, judged: Judged) -> Detection:
        status, rejected = DetectionStatus.NOT_FOUND, list_rejected(judged, None, picture.lens)
        return Detection(target=self._name, status=status, reason=reason, rejected=rejected)


def _are_one(one: Disc, other: Disc) -> bool:
    half_axes, apart_px = _apart(one, other)
    return bool(np.linalg.norm(np.linalg.solve(half_axes, apart_px)) < 1)


def _apart(one: Disc, other: Disc) -> tuple[Points, Points]:
    """Return the half axes of the ellipse half way between two discs, and how far apart they are."""
    first, second = one.edges.ellipse, other.edges.ellipse
    return (first.half_axes_px + second.half_axes_px) / 2, second.centre_px - first.centre_px


def _sigma_px(disc: Disc) -> float:
    """Return the standard deviation of the side that follows from the noise of one disc's edges."""
    # Blur and brightness move all edges of a disc outwards or inwards, so not its centre: what is left of the disc
    # detector's causes is scatter and what is hidden. Of n edges that err by σ each on its own, the diameter has the
    # variance 12 σ²/n, and the distance of two centres 4 σ²/n.
    edges = disc.edges
    alone_px = edges.sigma_px / math.sqrt(3)
    # Neighbouring edges err together, by either of two estimates, of which the larger one counts. They share pixels:
    # read bilinearly, two that are d px apart are correlated by (2 - d)³/4, from 1 px on. And the outline may be bent
    # by b, in each of `BEND_PARTS` parts.
    apart_px = min(max(edges.ellipse.perimeter_px() / THOROUGHLY.max_lines, 1.0), 2.0)
    shared_px = alone_px * math.sqrt(1 + (2 - apart_px) ** 3 / 2)
    bent_px = math.hypot(alone_px, 2 * edges.bend_px / math.sqrt(BEND_PARTS))
    return (1 + SIGMA_HIDDEN * (1 - edges.support)) * max(shared_px, bent_px)
