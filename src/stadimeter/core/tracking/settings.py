"""Settings for tracking targets, as the configuration says."""

from __future__ import annotations

from msgspec import Struct


class Tracking(Struct, frozen=True, kw_only=True):
    """Settings for tracking targets.

    Attributes:
        acceleration_mps2: Standard deviation of the target's acceleration that the filter expects.
        autocorrelation: Autocorrelation of the measurement noise from one frame to the next, 0 to below 1.
        gate_sigmas: A measurement further than this from the prediction is an outlier.
        outliers_max: After this many outliers in a row the target is taken to have jumped, and the track starts anew.
        confirm_frames: How many frames a new target must be measured in before it counts.
        coast_s: For how long a prediction stands in for measurements.
        noise_factor: How many times larger than stated the noise of measurements is, to begin with.
        noise_factor_max: How many times larger than that it may be found to be; 1 for not learning.
    """

    acceleration_mps2: float = 2.0
    autocorrelation: float = 0.6
    gate_sigmas: float = 4.0
    outliers_max: int = 5
    confirm_frames: int = 2
    coast_s: float = 0.3
    noise_factor: float = 1.0
    noise_factor_max: float = 6.0
