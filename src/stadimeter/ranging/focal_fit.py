"""One focal length, and one edge bias, from what several pictures say.

Every picture at a known distance gives a focal length F_i. If each edge is measured b pixels too far out, that is too
much by the share 2·b / P_i, P_i being how large the target appears: much where it is small and far away, little where
it is large and near. So with s_i = 2·F_i / P_i, by how much F_i is too large for each pixel of bias, all pictures agree
on

    F = F_i - s_i · b

which is linear in F and b. Weighted least squares solves it; the inverse of the normal matrix is their covariance
(W. H. Press et al., Numerical Recipes, 3rd edition, section 15.4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BIAS_SIGMA_LIMIT_PX = 0.3
"""Edge biases are mostly below this; a fit that is less sure of its bias than this says less than to assume none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalEstimate:
    """The focal length that one picture gives."""

    focal_px: float  # the focal length if there is no edge bias, F_i
    sigma_px: float  # its standard deviation
    per_bias: float  # by how much it is too large for each pixel of edge bias, s_i


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalFit:
    """What all pictures give together."""

    focal_px: float
    focal_sigma_px: float  # its standard deviation: what follows from that of the pictures, or more if they disagree
    edge_bias_px: float  # the edge bias; 0 where the pictures do not tell it
    # Its standard deviation from these pictures, whether or not it was used; infinite where all are at one
    # distance.
    edge_bias_sigma_px: float
    bias_was_fitted: bool  # whether the pictures tell the edge bias


def fit_focal_length(estimates: Sequence[FocalEstimate]) -> FocalFit:
    """Combine the focal lengths of one picture or more, with the edge bias if they tell it."""
    focal_px, weights = _columns(estimates)
    bias_sigma_px = edge_bias_sigma_px(estimates)
    together = np.column_stack((np.ones_like(focal_px), [each.per_bias for each in estimates]))
    alone = together[:, :1]
    if bias_sigma_px <= BIAS_SIGMA_LIMIT_PX:
        (focal, bias), covariance = _solved(together, focal_px, weights)
        bias_sigma_px = math.sqrt(covariance[1, 1])
        if bias_sigma_px <= BIAS_SIGMA_LIMIT_PX:
            return FocalFit(
                focal_px=float(focal),
                focal_sigma_px=math.sqrt(covariance[0, 0]),
                edge_bias_px=float(bias),
                edge_bias_sigma_px=bias_sigma_px,
                bias_was_fitted=True,
            )
    (focal,), covariance = _solved(alone, focal_px, weights)
    return FocalFit(
        focal_px=float(focal),
        focal_sigma_px=math.sqrt(covariance[0, 0]),
        edge_bias_px=0.0,
        edge_bias_sigma_px=bias_sigma_px,
        bias_was_fitted=False,
    )


def edge_bias_sigma_px(estimates: Sequence[FocalEstimate]) -> float:
    """Return how well pictures tell the edge bias, before it is known whether they agree; infinite if they do not."""
    _, weights = _columns(estimates)
    per_bias = np.array([each.per_bias for each in estimates])
    mean = float(np.average(per_bias, weights=weights))
    information = float(np.sum(weights * (per_bias - mean) ** 2))
    return 1 / math.sqrt(information) if information > 1e-12 * float(np.sum(weights)) * mean**2 else math.inf


def _columns(estimates: Sequence[FocalEstimate]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    focal_px = np.array([each.focal_px for each in estimates])
    sigma_px = np.maximum([each.sigma_px for each in estimates], 1e-9 * focal_px)
    return focal_px, 1 / sigma_px**2


def _solved(
    design: NDArray[np.float64], values: NDArray[np.float64], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the weighted least squares solution and its covariance, widened where the values disagree."""
    covariance = np.linalg.inv(design.T @ (design * weights[:, None])).astype(np.float64)
    solution = covariance @ (design.T @ (weights * values))
    spare = len(values) - design.shape[1]
    if spare == 0:
        return solution, covariance
    disagreement = float(np.sum(weights * (values - design @ solution) ** 2)) / spare
    return solution, covariance * max(1.0, disagreement)
