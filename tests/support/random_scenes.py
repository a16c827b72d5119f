"""What is seen in a random run, and what operators say, from a seed."""

from __future__ import annotations

import random
from collections.abc import Iterator

from msgspec.structs import replace

from stadimeter.core.command import BaseReport
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.observing import measured, missed
from support.random_rules import LIMIT_M, TARGETS

# What an operator sets of a rule. The other actions are those of `random_run`, whose seeds stay what they are.
SETTING = tuple(
    OperatorAction(name) for name in ("set-threshold", "set-threshold", "withdraw-threshold", "observe", "act")
)


class RandomScene:
    """Two targets that come, go and move at random, a base, and a clock."""

    def __init__(self, rng: random.Random, fps: int, names: tuple[str, ...], *, is_aimed: bool) -> None:
        self.rng = rng
        self.step_s = 1 / fps
        self.names = names
        self.is_aimed = is_aimed
        self.at_m = dict.fromkeys(TARGETS, 1.5)
        self.speed_mps = dict.fromkeys(TARGETS, 0.0)
        self.gone = dict.fromkeys(TARGETS, 0)
        self.sigma_m = rng.choice((0.0, 0.002) if is_aimed else (0.0, 0.002, 0.03, 0.1, 0.5))
        self.has_wall = rng.random() < 0.7
        self.undelivered_since_s: float | None = None

    def observations(self, cycles: int) -> Iterator[Observation]:
        """Cycles with a frame each, or a camera that says nothing, or a program that stood still."""
        now_s, sequence = 100.0, 0
        for _ in range(cycles):
            chance = self.rng.random()
            now_s += self.rng.uniform(1.0, 8.0) if chance < 0.01 else self.step_s
            wall = WallTime(second_of_day=43100 + now_s, weekday=2) if self.has_wall else None
            commands = (self._command(),) if self.names and self.rng.random() < 0.06 else ()
            if self.rng.random() < 0.05:
                self.undelivered_since_s = self.rng.choice((None, now_s, now_s - 0.3))
            if 0.01 < chance < 0.05:
                yield Observation(
                    now_s=now_s,
                    camera_fault="no frame in time",
                    wall=wall,
                    base=self._base(now_s),
                    operator_commands=commands,
                    undelivered_since_s=self.undelivered_since_s,
                )
                continue
            sequence += 1
            at_s = now_s - 0.01
            yield Observation(
                now_s=now_s,
                frame=FrameStamp(sequence=sequence, captured_at_s=at_s),
                measurements=tuple(self._look(target, at_s) for target in TARGETS),
                wall=wall,
                base=self._base(now_s),
                operator_commands=commands,
                undelivered_since_s=self.undelivered_since_s,
            )

    def _base(self, now_s: float) -> BaseReport | None:
        """A base that loses its link at times; bumps, and a battery that sags around the thresholds."""
        rng = self.rng
        if rng.random() < 0.05:
            return None
        return BaseReport(
            at_s=now_s,
            battery_v=rng.choice((None, 10.7, 10.8, 11.0, 11.1, 11.6)),
            is_bumped=rng.choice((None, False, False, True)),
            is_at_cliff=rng.random() < 0.1,
        )

    def _look(self, target: str, at_s: float) -> Measurement:
        rng = self.rng
        if self.is_aimed and rng.random() < 0.1:
            self.at_m[target] = LIMIT_M + rng.choice((-0.3, 0.15, 0.8))
        elif rng.random() < 0.1:
            self.speed_mps[target] = rng.choice((0.0, 0.0, rng.gauss(0, 1.0)))
        self.at_m[target] = min(max(self.at_m[target] + self.speed_mps[target] * self.step_s, 0.3), 4.0)
        self.gone[target] = self.gone[target] - 1 if self.gone[target] else 0
        if not self.gone[target] and rng.random() < 0.05:
            self.gone[target] = rng.choice((1, 5, 40))
        if self.gone[target]:
            return missed(target, at_s)
        distance_m = max(0.05, rng.gauss(self.at_m[target], self.sigma_m))
        if rng.random() < 0.04:
            distance_m += rng.choice((0.8, 3.0))  # an outlier
        found = measured(target, at_s, distance_m, self.sigma_m, rng.gauss(0.0, 0.1))
        elevation_rad, size_share = rng.gauss(0.0, 0.05), rng.choice((None, 0.2 / distance_m))
        noise_m = self.sigma_m * rng.choice((1.0, 1.0, 0.3))
        return replace(found, noise_m=noise_m, elevation_rad=elevation_rad, size_share=size_share)

    def _command(self) -> OperatorCommand:
        rng = self.rng
        return OperatorCommand(
            id="1",
            action=rng.choice([action for action in OperatorAction if action not in SETTING]),
            rule=rng.choice(("", *self.names)),
            for_s=rng.choice((None, 0.5, 3.0)),
            one_shot=rng.random() < 0.5,
            by="Ada",
        )
