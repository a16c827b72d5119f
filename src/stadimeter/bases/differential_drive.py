"""Kinematics of a robot with a driven wheel on each side. Pure functions of numbers.

With speed v, rate of turn ω (positive to the left) and track width b, the wheels run at v ∓ ω·b/2, left and right.
Source: the standard model of a differential drive, e.g. Siegwart and Nourbakhsh, Introduction to Autonomous Mobile
Robots, section 3.2.
"""

from __future__ import annotations

from msgspec import Struct


class Motion(Struct, frozen=True, kw_only=True):
    """The robot's speed forwards, and its rate of turn, positive to the left."""

    linear_mps: float
    angular_radps: float


class WheelSpeeds(Struct, frozen=True, kw_only=True):
    """The speeds at which both wheels roll, positive forwards."""

    left_mps: float
    right_mps: float


class DifferentialDrive(Struct, frozen=True, kw_only=True):
    """A robot's wheels.

    Attributes:
        track_width_m: Distance between the middles of the two wheels.
        max_wheel_mps: No wheel rolls faster.
    """

    track_width_m: float
    max_wheel_mps: float

    def wheels(self, motion: Motion) -> WheelSpeeds:
        """Return the wheel speeds for a motion.

        If a wheel would be too fast, both are slowed in the same proportion, so the robot keeps to its curve and
        drives along it more slowly.
        """
        offset_mps = motion.angular_radps * self.track_width_m / 2
        left_mps, right_mps = motion.linear_mps - offset_mps, motion.linear_mps + offset_mps
        fastest_mps = max(abs(left_mps), abs(right_mps))
        scale = self.max_wheel_mps / fastest_mps if fastest_mps > self.max_wheel_mps else 1.0
        return WheelSpeeds(left_mps=left_mps * scale, right_mps=right_mps * scale)

    def motion(self, wheels: WheelSpeeds) -> Motion:
        """Return the motion that wheel speeds make."""
        return Motion(
            linear_mps=(wheels.left_mps + wheels.right_mps) / 2,
            angular_radps=(wheels.right_mps - wheels.left_mps) / self.track_width_m,
        )
