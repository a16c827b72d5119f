"""How far two targets are apart, and how sure that and their directions are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel, LensUncertainty
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.ranging.flat import TagShape
from stadimeter.ranging.measure import SeenTarget, direction_sigmas_rad, measure, separation
from stadimeter.ranging.plane_pose import rectangle
from support.corners import detection_of_corners

LENS = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=612.0,
    fy_px=610.0,
    cx_px=315.0,
    cy_px=246.0,
    distortion=(-0.2, 0.06, 0.001, -0.0005, 0.0),
)
TAG = TagShape(side_m=0.08, relative_sigma=0.01)
SIGMA_PX = 0.1
PLACES_M = np.array(((-0.25, -0.1, 0.8), (0.3, 0.15, 1.1)))


def seen(place_m: np.ndarray, model: CameraModel, rng: np.random.Generator, side_m: float = 0.08) -> SeenTarget:
    """Return a tag that is seen through `LENS` with noise, and measured through another model."""
    turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
    there = (rectangle(side_m, side_m) * (1, -1, 1)) @ turn.T + place_m
    corners_px = LENS.project(there[:, :2] / there[:, 2:]) + rng.normal(0, SIGMA_PX / np.sqrt(2), (4, 2))
    found = detection_of_corners(corners_px, SIGMA_PX, "tag")
    return SeenTarget(detection=found, measurement=measure(found, TAG, model, 0.0), shape=TAG)


def wrong_lens(rng: np.random.Generator) -> CameraModel:
    """Return a model that errs as its uncertainty says."""
    sigmas = (4.0, 4.0, 2.0, 2.0, 0.01, 0.02, 0.001, 0.001, 0.0)
    correlations = (0.9, *(0.0,) * 35)  # of fx and fy
    uncertainty = LensUncertainty(sigmas=sigmas, correlations=correlations)
    off = rng.multivariate_normal(np.zeros(9), uncertainty.covariance())
    fx, fy, cx, cy = np.array([LENS.fx_px, LENS.fy_px, LENS.cx_px, LENS.cy_px]) + off[:4]
    distortion = tuple(float(each) for each in np.array(LENS.distortion) + off[4:])
    return replace(LENS, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=distortion, uncertainty=uncertainty)


def test_the_interval_of_a_separation_holds() -> None:
    true_m = float(np.linalg.norm(PLACES_M[1] - PLACES_M[0]))
    missed = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        model = wrong_lens(rng)
        side_m = 0.08 * (1 + rng.normal(0, 0.01))  # of both: they are printed alike
        found = separation(*(seen(place_m, model, rng, side_m) for place_m in PLACES_M), model)
        assert found is not None
        missed.append((found.distance_m - true_m) / found.sigma_m)
    inside = np.mean(np.abs(missed) < 1.96)
    assert 0.91 <= inside <= 0.99
    assert 0.8 < np.std(missed) < 1.25


def test_the_intervals_of_a_direction_hold() -> None:
    x, y, z = PLACES_M[1]
    true = np.array((np.arctan2(x, z), -np.arctan2(y, np.hypot(x, z))))
    missed = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        model = wrong_lens(rng)
        target = seen(PLACES_M[1], model, rng)
        sigmas = direction_sigmas_rad(target, model)
        assert sigmas is not None
        measured = np.array((target.measurement.bearing_rad, target.measurement.elevation_rad))
        missed.append((measured - true) / sigmas)
    assert all(0.9 <= share <= 0.99 for share in (np.abs(missed) < 1.96).mean(axis=0))


def test_a_common_error_of_the_focal_length_hardly_moves_targets_beside_each_other() -> None:
    rng = np.random.default_rng(1)
    model = replace(LENS, focal_relative_sigma=0.05)
    beside = [seen(np.array((x_m, 0.0, 1.0)), model, rng) for x_m in (-0.2, 0.2)]
    behind = [seen(np.array((0.0, 0.0, z_m)), model, rng) for z_m in (0.6, 1.0)]
    shares = [found.sigma_m / found.distance_m for pair in (beside, behind) if (found := separation(*pair, model))]
    assert shares[0] < 0.02
    assert shares[1] == pytest.approx(0.05, abs=0.015)


def test_without_two_measurements_there_is_none() -> None:
    one = seen(PLACES_M[0], LENS, np.random.default_rng(0))
    gone = Detection(target="tag", status=DetectionStatus.NOT_FOUND, reason="no tag")
    other = SeenTarget(detection=gone, measurement=measure(gone, TAG, LENS, 0.0), shape=TAG)
    assert separation(one, other, LENS) is None
    assert direction_sigmas_rad(other, LENS) is None
