"""A circle through points of which many do not belong to it: seams, fingers, the texture of what is behind a ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Weights = NDArray[np.float64]

TRIES = 400
"""With a quarter of the points on the circle, 400 triples miss it twice in a thousand times; with a third, never."""

SECTORS = 72
"""The circle's circumference is counted in sectors of five degrees."""

PRIOR_ELLIPTICITY = 0.05
"""The shape of an arc hardly says how elliptical the whole is; what it does not say is held near a circle, to within
this share of the radius. Thirty degrees off the optical axis a ball's radii differ by 8 % either way."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in pixels.

    Attributes:
        x_px: Horizontal coordinate of its centre.
        y_px: Vertical coordinate of its centre.
        radius_px: Its radius.
    """

    x_px: float
    y_px: float
    radius_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundOutline:
    """A slightly elliptical outline, and how well points lie on it.

    Attributes:
        circle: The circle of its mean radius.
        bend_px: How much its radius differs from that at an angle: these times cosine and sine of twice the angle.
        on_outline: Which of the points lie on it, shape ``(n,)``.
        coverage: The share of its circumference that has points on it, 0 to 1.
        scatter_px: Standard deviation of those points about it.
    """

    circle: Circle
    bend_px: tuple[float, float]
    on_outline: NDArray[np.bool_]
    coverage: float
    scatter_px: float

    @classmethod
    def of(cls, circle: Circle) -> RoundOutline:
        """Return a circle as an outline that no points lie on."""
        return cls(circle=circle, bend_px=(0.0, 0.0), on_outline=np.empty(0, bool), coverage=0.0, scatter_px=0.0)

    def radii_px(self, angles_rad: Points) -> Points:
        """Return its radius at each angle, counted from the x axis towards the y axis."""
        bent = self.bend_px[0] * np.cos(2 * angles_rad) + self.bend_px[1] * np.sin(2 * angles_rad)
        return np.asarray(self.circle.radius_px + bent, np.float64)

    def diameter_across_px(self, direction: tuple[float, float]) -> float:
        """Return its diameter at right angles to a direction.

        An ellipse with the half axes c (1 + e) and c (1 - e) has the mean radius ``c (1 - 3 e² / 4)``, up to the fourth
        power of e.

        Args:
            direction: The direction, x and y, of any length but zero; for none of any length, the mean diameter.
        """
        x, y = direction
        squared = x * x + y * y
        bend2_px2 = self.bend_px[0] ** 2 + self.bend_px[1] ** 2
        middle_px = self.circle.radius_px + 0.75 * bend2_px2 / self.circle.radius_px
        if squared == 0:
            return 2 * middle_px
        along = (self.bend_px[0] * (x * x - y * y) + self.bend_px[1] * 2 * x * y) / squared
        return 2 * (middle_px - along)


def find_circle(
    points_px: Points, strength: Weights, around_px: Points, area_px2: float, band: tuple[float, float]
) -> Circle | None:
    """Find the circle that has strong points on most of its circumference and is filled by something.

    Circles through three points each are tried. The same points always give the same circle.

    Args:
        points_px: The points, shape ``(n, 2)``.
        strength: How much each counts, 0 to 1, shape ``(n,)``.
        around_px: Points that the circle should enclose, shape ``(m, 2)``.
        area_px2: The area of what should fill it.
        band: How far from a circle its points may lie: in pixels, and as a share of the radius if that is more.

    Returns:
        The circle, or None if no three points form one.
    """
    if len(points_px) < 6:
        return None
    circles = _circles_through_triples(points_px)
    if not len(circles):
        return None
    fill = np.minimum(1.0, area_px2 / (np.pi * circles[:, 2] ** 2))
    score = _coverages(points_px, strength, circles, band) * _enclosed(around_px, circles) * np.sqrt(fill)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return Circle(x_px=x, y_px=y, radius_px=radius)


def fit_outline(points_px: Points, start: RoundOutline, band_px: float, band_share: float) -> RoundOutline | None:
    """Fit a slightly elliptical outline to the points near one.

    To first order an ellipse's radius is its mean radius and two terms that turn twice as fast as the angle, and a
    shift of its centre is two terms that turn with it: five unknowns, linear. Tukey's weights leave out what is far
    off; first with a wide band, then with one that follows how the points scatter.

    Args:
        points_px: The points, shape ``(n, 2)``.
        start: An outline near the one that is meant.
        band_px: Points further from the outline than this never count, unless
        band_share: times the radius is more.

    Returns:
        The outline, or None where too few points are near it.
    """
    circle = np.array([start.circle.x_px, start.circle.y_px, start.circle.radius_px])
    bend = np.array(start.bend_px)
    widest = band = max(band_px, band_share * start.circle.radius_px)
    for _ in range(12):
        step = _outline_step(points_px, circle, bend, band)
        if step is None:
            return None
        circle, bend, scatter = step
        band = min(widest, max(band_px, 4.0 * scatter))
    return _described(points_px, circle, bend, band)


def _circles_through_triples(points: Points) -> Points:
    """Return the circles through random triples of points as x, y, radius, shape ``(m, 3)``."""
    picks = np.random.default_rng(0).integers(0, len(points), (TRIES, 3))
    a, b, c = points[picks[:, 0]], points[picks[:, 1]], points[picks[:, 2]]
    ab, ac = b - a, c - a
    twice_area = 2 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    apart = np.abs(twice_area) > 1e-6
    ab, ac, a, twice_area = ab[apart], ac[apart], a[apart], twice_area[apart]
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    x = (ac[:, 1] * ab2 - ab[:, 1] * ac2) / twice_area
    y = (ab[:, 0] * ac2 - ac[:, 0] * ab2) / twice_area
    radius = np.hypot(x, y)
    size = float(np.ptp(points, axis=0).max())
    circles = np.column_stack([a[:, 0] + x, a[:, 1] + y, radius])
    return np.asarray(circles[(radius > 1.0) & (radius < size)])


def _coverages(points: Points, strength: Weights, circles: Points, band: tuple[float, float]) -> Weights:
    """Return for each circle the mean over its sectors of the strongest point on it there."""
    dx = points[None, :, 0] - circles[:, None, 0]
    dy = points[None, :, 1] - circles[:, None, 1]
    radius = circles[:, None, 2]
    near = np.abs(np.hypot(dx, dy) - radius) < np.maximum(band[0], band[1] * radius)
    row, point = np.nonzero(near)
    sector = _sectors(dx[row, point], dy[row, point])
    strongest = np.zeros((len(circles), SECTORS))
    np.maximum.at(strongest, (row, sector), strength[point])
    return np.asarray(strongest.mean(axis=1), np.float64)


def _sectors(dx: Points, dy: Points) -> NDArray[np.intp]:
    return ((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS


def _enclosed(around: Points, circles: Points) -> Weights:
    """Return for each circle the share of the points that it encloses, give or take 5 % of its radius."""
    dx = around[None, :, 0] - circles[:, None, 0]
    dy = around[None, :, 1] - circles[:, None, 1]
    return np.asarray((np.hypot(dx, dy) < 1.05 * circles[:, None, 2] + 1.0).mean(axis=1), np.float64)


def _outline_step(points: Points, circle: Points, bend: Points, band: float) -> tuple[Points, Points, float] | None:
    """Return circle, ellipse terms and scatter after one step of Gauss and Newton; None where too few points count."""
    dx, dy = points[:, 0] - circle[0], points[:, 1] - circle[1]
    angle = np.arctan2(dy, dx)
    radius = np.hypot(dx, dy)
    twice = np.column_stack([np.cos(2 * angle), np.sin(2 * angle)])
    residual = radius - circle[2] - twice @ bend
    weight = np.where(np.abs(residual) < band, (1 - (residual / band) ** 2) ** 2, 0.0)
    if (weight > 0).sum() < 6:
        return None
    rows = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(points)), twice])
    scatter = float(np.sqrt((weight * residual**2).sum() / weight.sum()))
    prior = np.zeros(5)
    prior[3:] = (max(scatter, 0.1) / (PRIOR_ELLIPTICITY * circle[2])) ** 2
    normal = rows.T @ (weight[:, None] * rows) + np.diag(prior)
    if np.linalg.cond(normal) > 1e9:
        return None
    right = rows.T @ (weight * residual) - prior * np.concatenate([np.zeros(3), bend])
    change = np.linalg.solve(normal, right)
    return circle + change[:3], bend + change[3:], scatter


def _described(points: Points, circle: Points, bend: Points, band: float) -> RoundOutline | None:
    x, y, mean_radius = (float(value) for value in circle)
    if not (np.isfinite(circle).all() and mean_radius > 0):
        return None
    dx, dy = points[:, 0] - x, points[:, 1] - y
    angle = np.arctan2(dy, dx)
    residual = np.hypot(dx, dy) - mean_radius - bend[0] * np.cos(2 * angle) - bend[1] * np.sin(2 * angle)
    on_outline = np.abs(residual) < band
    return RoundOutline(
        circle=Circle(x_px=x, y_px=y, radius_px=mean_radius),
        bend_px=(float(bend[0]), float(bend[1])),
        on_outline=on_outline,
        coverage=len(np.unique(_sectors(dx[on_outline], dy[on_outline]))) / SECTORS,
        scatter_px=float(np.std(residual[on_outline])) if on_outline.any() else 0.0,
    )
