"""What one method made of one picture, and what many of those come to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from msgspec import Struct

from stadimeter.core.measurement import Measurement
from support.scenes.scene import Truth

OURS, TUTORIAL = "stadimeter", "tutorial"
SIGMAS_OF_95 = 1.96


class Sample(Struct, frozen=True, kw_only=True):
    """What one method made of one picture.

    Attributes:
        row: The conditions, such as a nuisance.
        method: Who measured.
        seed: The scene.
        apparent_px: How large the target truly appears.
        true_m: What should have been measured.
        measured_m: What was; None if there was no answer.
        sigma_m: The standard deviation that came with it; None if there was none.
    """

    row: str
    method: str
    seed: int
    apparent_px: float
    true_m: float
    measured_m: float | None
    sigma_m: float | None = None

    @property
    def error(self) -> float:
        """The relative error; NaN without an answer."""
        return math.nan if self.measured_m is None else self.measured_m / self.true_m - 1

    @property
    def bias_px(self) -> float:
        """By how many pixels the target was measured too large, if its size alone is to blame."""
        return math.nan if not self.measured_m else self.apparent_px * (self.true_m / self.measured_m - 1)

    @property
    def is_covered(self) -> bool:
        """Whether the truth is inside the 95 % interval."""
        if self.measured_m is None or self.sigma_m is None:
            return False
        return abs(self.measured_m - self.true_m) <= SIGMAS_OF_95 * self.sigma_m


def ours_of(row: str, seed: int, truth: Truth, measured: Measurement) -> Sample:
    """Return what stadimeter made of a picture: the straight line to the centre, which is what it promises."""
    return Sample(
        row=row,
        method=OURS,
        seed=seed,
        apparent_px=truth.apparent_px,
        true_m=truth.distance_m,
        measured_m=measured.distance_m,
        sigma_m=measured.sigma_m,
    )


class Summary(Struct, frozen=True, kw_only=True):
    """What many samples come to.

    Attributes:
        count: How many there are.
        found: The share with an answer.
        median: Median of the absolute relative error, of those with an answer.
        p95: Its 95th percentile.
        bias: Median of the signed relative error.
        gross: The share of all with an answer that is wrong beyond the limit.
        bias_px: Median of the signed error in pixels.
        coverage: The share of answers whose 95 % interval holds the truth; NaN if none has an interval.
    """

    count: int
    found: float
    median: float
    p95: float
    bias: float
    gross: float
    bias_px: float
    coverage: float

    @property
    def percents(self) -> str:
        """Median and 95th percentile in percent."""
        return "–" if math.isnan(self.median) else f"{100 * self.median:.2f} / {100 * self.p95:.1f}"

    @property
    def failures(self) -> str:
        """Shares of gross errors and of missing answers in percent."""
        return f"{100 * self.gross:.1f} / {100 * (1 - self.found):.1f}"


def summarise(samples: Sequence[Sample], gross_limit: float) -> Summary:
    """Return what samples come to.

    Args:
        samples: The samples.
        gross_limit: From which relative error on an answer is simply wrong.

    Returns:
        The summary; its figures are NaN where there is nothing to compute them from.
    """
    answered = [sample for sample in samples if sample.measured_m is not None]
    errors = np.array([abs(sample.error) for sample in answered])
    stated = [sample for sample in answered if sample.sigma_m is not None]
    return Summary(
        count=len(samples),
        found=len(answered) / len(samples) if samples else math.nan,
        median=_quantile(errors, 0.5),
        p95=_quantile(errors, 0.95),
        bias=_quantile(np.array([sample.error for sample in answered]), 0.5),
        gross=float((errors > gross_limit).sum()) / len(samples) if samples else math.nan,
        bias_px=_quantile(np.array([sample.bias_px for sample in answered]), 0.5),
        coverage=sum(sample.is_covered for sample in stated) / len(stated) if stated else math.nan,
    )


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (E. B. Wilson, 1927); NaN without frames."""
    if not count or math.isnan(share):
        return math.nan, math.nan
    z2 = SIGMAS_OF_95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = SIGMAS_OF_95 / (1 + z2 / count) * math.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def rate(share: float, count: int) -> str:
    """Return a rate in percent with its interval."""
    low, high = wilson(share, count)
    return "–" if math.isnan(low) else f"{100 * share:.1f} ({100 * low:.1f}–{100 * high:.1f})"


def grouped(samples: Iterable[Sample], key: Callable[[Sample], str]) -> dict[str, list[Sample]]:
    """Return samples by a key, in the order in which the keys first appear."""
    groups: dict[str, list[Sample]] = {}
    for sample in samples:
        groups.setdefault(key(sample), []).append(sample)
    return groups


def _quantile(values: np.ndarray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan
