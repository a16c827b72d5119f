"""Kinematics of a robot with a driven wheel on each side. Pure functions of numbers.

With speed v, rate of turn ω (positive to the left) and track width b, the wheels run at v ∓ ω·b/2, left and right.
Source: the standard model of a differential drive, e.g. Siegwart and Nourbakhsh, Introduction to Autonomous Mobile
Robots, section 3.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The robot's speed forwards, and its rate of turn, positive to the left."""

    linear_mps: float
    angular_radps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelTicks:
    """Whole encoder ticks, positive forwards, that both wheels shall make in one frame of the base's speed control."""

    left: int
    right: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive:
    """A robot's wheels, and how its base counts their speed.

    Attributes:
        track_width_m: Distance between the middles of the two wheels.
        ticks_per_metre: Encoder ticks while a wheel rolls one metre.
        frame_s: Length of one frame of the base's speed control.
    """

    track_width_m: float
    ticks_per_metre: float
    max_wheel_mps: float
    frame_s: float

    @property
    def tick_mps(self) -> float:
        """The wheel speed of one tick per frame: the smallest that can be commanded, and the step between speeds."""
        return 1.0 / (self.ticks_per_metre * self.frame_s)

    @property
    def max_ticks(self) -> int:
        """The most ticks per frame that keep a wheel at or below its limit."""
        whole = math.floor(self.max_wheel_mps / self.tick_mps + 1e-9)  # a limit of exactly n ticks shall give n
        return max(0, whole)

    def ticks(self, motion: Motion) -> WheelTicks:
        """Return the wheel speeds for a motion, limited and rounded.

        If a wheel would be too fast, both are slowed in the same proportion, so the robot keeps to its curve and
        drives along it more slowly.
        """
        offset_mps = motion.angular_radps * self.track_width_m / 2
        left = (motion.linear_mps - offset_mps) / self.tick_mps
        right = (motion.linear_mps + offset_mps) / self.tick_mps
        fastest = max(abs(left), abs(right))
        scale = self.max_ticks / fastest if fastest > self.max_ticks else 1.0
        return WheelTicks(left=round(left * scale), right=round(right * scale))

    def motion(self, ticks: WheelTicks) -> Motion:
        """Return the motion that wheel speeds make."""
        left_mps, right_mps = ticks.left * self.tick_mps, ticks.right * self.tick_mps
        return Motion(
            linear_mps=(left_mps + right_mps) / 2,
            angular_radps=(right_mps - left_mps) / self.track_width_m,
        )
