"""The size of a thing from how it grows in the picture while the camera moves by known steps.

One picture cannot tell a small thing nearby from a large one far away. But every shape's `locate` is homogeneous: with
a size k times as large, each position that it gives is k times as far, in the same direction. So a target is located
with an assumed size, and one unknown factor k makes a ball, a disc, a sheet and a tag right at once.

Let a thing stand still at c. From a camera that has moved by p_i, without turning, it is located at a_i, in the camera
frame, with the assumed size. Then ``k a_i = c - p_i``. With g = 1 / k and b = c / k that is

    ``a_i = b - g p_i``,

linear in the four unknowns g and b, with what errs on the left side: fitted as ``k a_i + p_i = c`` instead, noise in
a_i would make k too small (errors in the regressor). Ahead, the depth shrinks by the way; sideways, the bearing changes
(parallax); both are in the same equations.

The unknowns follow by generalised least squares, ``x = (H' C⁻¹ H)⁻¹ H' C⁻¹ a`` (A. C. Aitken, 1935), with the joint
covariance C of all positions:

- the noise of each picture, along the line of sight and across it;
- what errs alike in all pictures: the lens, the edge bias, the doubt about a pose. It does not cancel: through a focal
  length that is 1 % too long the size is 1 % too large, as growth looks 1 % too small; an edge bias of e px takes
  2 e (1/P_1 + 1/P_2) of the size for apparent sizes P_1 and P_2, more than of one distance;
- turns of the camera between pictures, σ a × (direction);
- the steps, times g: places that err by themselves, and a common turn of all of them, as "ahead" is not quite the
  direction in which the camera looks. As g is not known before, the fit is repeated with the one that it gave.

A common error of the steps' scale, as of a wheel's circumference, goes straight into g. Its variance is added at the
end, and so is the mean square of 1 - cos of the common turn, by which a step ahead is shorter than it seems.

The residuals say whether the thing stood still: ``r' C⁻¹ r`` is chi-square with 3 n - 4 degrees of freedom. Two
pictures show by it whether it moved across, only three or more whether it came nearer by itself.

Most of these degrees are across the way, where turns of the camera leave nothing to be seen. So each step has a test of
its own, of a shift u of all places behind it (W. Baarda, "A testing procedure for use in geodetic networks", 1968):
``w = u' C⁻¹ r / √(u' C⁻¹ Q C⁻¹ u)`` with the residuals' covariance Q is a standard normal deviate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Values
from stadimeter.errors import CalibrationError
from stadimeter.ranging.measure import SeenTarget, direction_sigma_px, moved_by_lens, sigma_parts

Vector = tuple[float, float, float]

# A size that is less well known is none: at 20 % its interval is no longer even nearly symmetrical.
MAX_SHARE = 0.2

# One of a thousand things that stand still is refused: the one-sided standard normal deviate.
MISFIT_SIGMAS = 3.1

# Two of a hundred series of right steps are refused: the share that all tests of single steps have together.
_REFUSED_SHARE = 0.02

# The part of the edges' standard deviation that differs between pictures of one thing, from one camera; the rest is
# alike in all. Rendered balls scatter by 0.4 of what is stated, tags by 0.7.
_OWN_EDGES_SHARE = 0.7

# Places that are no further apart are one.
MIN_WAY_M = 1e-3

# Fits until the slope, which the weights of the steps depend on, stays: from the fourth on to 1e-6.
FITS = 6


class StepErrors(Struct, frozen=True, kw_only=True):
    """The uncertainty of the camera's steps: standard deviations.

    Attributes:
        scale_share: Of what is wrong with all steps alike, such as a wheel's circumference, as a share of them.
        place_m: Of each place by itself, along each axis.
        aim_rad: Of the angle between the direction that is called ahead and that in which the camera looks, about each
            axis; the same for all steps.
        turn_rad: Of how far the camera has turned in each picture, about each axis.
    """

    scale_share: float = 0.02
    place_m: float = 0.004
    aim_rad: float = math.radians(3.0)
    turn_rad: float = math.radians(2.0)


class StepView(Struct, frozen=True, kw_only=True):
    """The place a target is seen at after a step, with an assumed size.

    Attributes:
        moved_m: How far the camera has moved since the first picture: x right, y down, z in the direction that is
            called ahead.
        position_m: Where the target is in the camera frame, if it has the assumed size.
        outwards_m: Standard deviation of the noise along the line of sight, with that size.
        across_m: The same across it.
        lasting_m: Standard deviation along the line of sight of what errs alike in all pictures, but for the lens.
    """

    picture: str
    moved_m: Vector
    position_m: Vector
    outwards_m: float
    across_m: float
    lasting_m: float = 0.0


class LearntSize(Struct, frozen=True, kw_only=True):
    """A size that was learnt.

    Attributes:
        factor: How many times the assumed size it is.
        sigma_share: Standard deviation of the size, as a share of it. The squares of the following shares add up to its
            square.
        edges_share: The part from the noise of the edges.
        lens_share: From the lens, and what errs alike in all pictures.
        steps_share: From the camera's steps.
        turn_share: From turns of the camera.
        is_proved: Whether there are enough places to see that it stood still.
    """

    factor: float
    sigma_share: float
    edges_share: float
    lens_share: float
    steps_share: float
    turn_share: float
    is_proved: bool


def view_of(picture: str, seen: SeenTarget, camera: CameraModel, moved_m: Vector) -> StepView | None:
    """Return where a target of an assumed size is seen; None if it was not measured.

    Args:
        camera: The camera model at the picture's resolution.
        moved_m: As `StepView` has it.
    """
    parts, position_m = sigma_parts(seen.measurement, seen.shape, camera), seen.measurement.position_m
    if parts is None or position_m is None:
        return None
    across_m = direction_sigma_px(seen.detection) / math.sqrt(camera.fx_px * camera.fy_px) * position_m[2]
    return StepView(
        picture=picture,
        moved_m=moved_m,
        position_m=position_m,
        outwards_m=_OWN_EDGES_SHARE * parts.edges_m,
        across_m=across_m,
        lasting_m=math.hypot(parts.pose_m, math.sqrt(1 - _OWN_EDGES_SHARE**2) * parts.edges_m),
    )


def learn_size(views: Sequence[StepView], camera: CameraModel, errors: StepErrors) -> LearntSize:
    """Return the size of a target that was seen from several places.

    Args:
        camera: The camera model, at any resolution: how well the lens is known.

    Raises:
        CalibrationError: There is no step, the size is not known to `MAX_SHARE`, or the target moved, or the steps are
            wrong.
    """
    _check_moved(views)
    steps = _Steps(views, camera, errors)
    fit = steps.fit()
    # Each step is tested (Bonferroni's correction); of three places both tests are one.
    tests = len(views) - 1 if len(views) > 3 else 1
    limit_sigmas = NormalDist().inv_cdf(1 - _REFUSED_SHARE / 2 / tests)
    if fit.misfit_sigmas > MISFIT_SIGMAS or fit.step_sigmas > limit_sigmas:
        raise CalibrationError(_misfit_words(views, fit))
    made = steps.learnt(fit)
    if made is None or made.sigma_share > MAX_SHARE:
        raise CalibrationError(_unknown_words(steps, made))
    return made


def _check_moved(views: Sequence[StepView]) -> None:
    if len(views) < 2:
        raise CalibrationError(
            "one picture says nothing about the size; move the camera towards the thing, and take another one"
        )
    moves = np.array([view.moved_m for view in views])
    if not float(np.ptp(moves, axis=0).max()) > MIN_WAY_M:
        raise CalibrationError(
            "all pictures are from one place, so the thing does not grow; say how far the camera has moved in each, "
            "such as b.jpg@20cm"
        )


class _SizeFit(Struct, frozen=True, eq=False):
    """A fit.

    Attributes:
        slope: The assumed size as a share of the true one.
        gain: How the slope follows from the positions, shape ``(3 n,)``.
        residuals: Of the positions, shape ``(n, 3)``, with the assumed size.
        misfit_sigmas: How large they are, as a standard normal deviate.
        step_sigmas: How far the step that fits worst is off, in standard deviations; 0 where none can be judged.
    """

    slope: float
    gain: Values
    residuals: Values
    misfit_sigmas: float
    step_sigmas: float


class _Steps:
    """Positions of all pictures, and the causes by which they err, each with its covariance, shape ``(3 n, 3 n)``."""

    def __init__(self, views: Sequence[StepView], camera: CameraModel, errors: StepErrors) -> None:
        self.positions = np.array([view.position_m for view in views])
        self.moves = np.array([view.moved_m for view in views])
        count = len(views)
        self._design = np.hstack((-self.moves.reshape(-1, 1), np.tile(np.eye(3), (count, 1))))
        self._edges = _blocks([_noise_m2(view) for view in views])
        self._turn = _blocks([_turned_m2(each, errors.turn_rad) for each in self.positions])
        lasting = np.concatenate([view.lasting_m * _unit(np.array(view.position_m)) for view in views])
        of_lens = np.vstack([moved_by_lens(each, camera) for each in self.positions])
        self._lens = of_lens @ _lens_covariance(camera) @ of_lens.T + np.outer(lasting, lasting)
        # A turn of all moves m about an axis e shifts them by e × m.
        aimed = np.stack([np.cross(axis, self.moves).ravel() for axis in np.eye(3)])
        self._steps = errors.place_m**2 * np.eye(3 * count) + errors.aim_rad**2 * aimed.T @ aimed
        # Of 1 - cos of turns about two axes, each with σ: both the mean and the standard deviation are σ².
        self._scale = math.hypot(errors.scale_share, math.sqrt(2) * errors.aim_rad**2)

    def fit(self) -> _SizeFit:
        """Fit slope and place."""
        off_m, off = self.moves - self.moves.mean(axis=0), self.positions - self.positions.mean(axis=0)
        fit = self._fit_with(-float((off_m * off).sum() / (off_m * off_m).sum()))
        for _ in range(FITS - 1):
            fit = self._fit_with(fit.slope)
        return fit

    def _fit_with(self, slope: float) -> _SizeFit:
        """Fit with the weights of steps that are so large with the assumed size."""
        covariance = self._edges + self._turn + self._lens + slope**2 * self._steps
        weighted = np.linalg.solve(covariance, self._design)
        gain = np.linalg.solve(self._design.T @ weighted, weighted.T)
        seen = self.positions.ravel()
        unknowns = gain @ seen
        residuals = seen - self._design @ unknowns
        square = float(residuals @ np.linalg.solve(covariance, residuals))
        misfit_sigmas = _deviate(square, len(seen) - 4)
        step_sigmas = self._worst_step(residuals, np.linalg.inv(covariance), weighted @ gain)
        return _SizeFit(float(unknowns[0]), gain[0], residuals.reshape(-1, 3), misfit_sigmas, step_sigmas)

    def _worst_step(self, residuals: Values, weights: Values, explained: Values) -> float:
        """Return the distance that the step that fits worst is off, in standard deviations: see the module.

        Args:
            weights: The inverse of the covariance.
            explained: The weights of what the fit takes up, so that the difference is C⁻¹ Q C⁻¹.
        """
        worst = 0.0
        for at, step_m in enumerate(np.diff(self.moves, axis=0), start=1):
            if float(np.linalg.norm(step_m)) > MIN_WAY_M:
                shift = np.zeros_like(self.moves)
                shift[at:] = _unit(step_m)
                shown = shift.ravel()
                alone = float(shown @ (weights - explained) @ shown)
                # What two places leave to be seen of their one step is nothing but rounding.
                if alone > 1e-9 * float(shown @ weights @ shown):
                    worst = max(worst, abs(float(shown @ weights @ residuals)) / math.sqrt(alone))
        return worst

    def learnt(self, fit: _SizeFit) -> LearntSize | None:
        """Return the size; None where the target has not grown at all."""
        if not fit.slope > 0:
            return None
        edges, lens, turn, steps = (
            math.sqrt(max(float(fit.gain @ cause @ fit.gain), 0.0))
            for cause in (self._edges, self._lens, self._turn, self._steps)
        )
        # Where a step fits worse than its standard deviation, that is the least by which steps and edges err.
        wider = max(1.0, fit.step_sigmas)
        steps_share = math.hypot(wider * steps, self._scale)  # these are times the slope already
        shares = wider * edges / fit.slope, lens / fit.slope, turn / fit.slope
        return LearntSize(
            factor=1 / fit.slope,
            sigma_share=math.hypot(*shares, steps_share),
            edges_share=shares[0],
            lens_share=shares[1],
            turn_share=shares[2],
            steps_share=steps_share,
            is_proved=len(np.unique(self.moves, axis=0)) > 2,
        )

    @property
    def way_m(self) -> float:
        """The distance between the places."""
        return float(np.linalg.norm(np.ptp(self.moves, axis=0)))


def _unit(vector: Values) -> Values:
    return np.asarray(vector / np.linalg.norm(vector))


def _noise_m2(view: StepView) -> Values:
    """Return the covariance of a position's own noise, shape ``(3, 3)``."""
    along = _unit(np.array(view.position_m))
    outwards = np.outer(along, along)
    # A detector that states no noise at all is taken at its word but for rounding.
    floor_m = 1e-6 * float(np.linalg.norm(view.position_m))
    return max(view.outwards_m, floor_m) ** 2 * outwards + max(view.across_m, floor_m) ** 2 * (np.eye(3) - outwards)


def _turned_m2(position_m: Values, turn_rad: float) -> Values:
    """Return the motion of a position by turns of the camera about each axis, as a covariance.

    They move it across the line of sight, and off it by the share 1 - cos, whose standard deviation for turns about two
    axes is the square of theirs.
    """
    along = np.outer(position_m, position_m)
    return np.asarray(turn_rad**2 * (position_m @ position_m * np.eye(3) - along) + turn_rad**4 * along)


def _lens_covariance(camera: CameraModel) -> Values:
    if camera.uncertainty is not None:
        return camera.uncertainty.covariance()
    both = np.zeros(9)
    both[:2] = camera.fx_px, camera.fy_px  # both wrong by the same share
    return camera.focal_relative_sigma**2 * np.outer(both, both)


def _blocks(each: Sequence[Values]) -> Values:
    """Return a matrix with smaller ones along its diagonal."""
    whole = np.zeros((3 * len(each), 3 * len(each)))
    for index, block in enumerate(each):
        whole[3 * index : 3 * index + 3, 3 * index : 3 * index + 3] = block
    return whole


def _deviate(chi_square: float, freedom: int) -> float:
    """Return a chi-square as a standard normal deviate (E. B. Wilson and M. M. Hilferty, 1931)."""
    spread = 2 / (9 * freedom)
    return (math.cbrt(chi_square / freedom) - (1 - spread)) / math.sqrt(spread)


def _misfit_words(views: Sequence[StepView], fit: _SizeFit) -> str:
    apart_m = np.linalg.norm(fit.residuals, axis=1) / max(fit.slope, 1e-9)
    worst = int(np.argmax(apart_m))
    return (
        f"the thing moved, or the steps are wrong: {views[worst].picture} fits worst, it is {100 * apart_m[worst]:.1f} "
        "cm off. Lengths count from the first picture, not from the one before, straight ahead unless they say "
        "another direction; the thing must stand still, and the camera look the same way in all pictures"
    )


def _unknown_words(steps: _Steps, made: LearntSize | None) -> str:
    way = f"over {100 * steps.way_m:.0f} cm"
    advice = "straight towards it, and check the steps as you gave them, their directions too"
    if made is None or made.sigma_share > 1:
        return f"the thing hardly grows {way}, so its size is not known; move the camera several times as far, {advice}"
    further = made.sigma_share / (MAX_SHARE / 2)
    return (
        f"the size is known to ± {made.sigma_share:.0%} only, more than ± {MAX_SHARE:.0%}, {way}; move the camera "
        f"about {100 * further * steps.way_m:.0f} cm, {advice}"
    )
