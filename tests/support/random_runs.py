"""Random rules on random observations, from a seed: for tests that compare two ways to decide on the same run."""

from __future__ import annotations

import random
from unittest.mock import patch

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms import alarm
from stadimeter.core.alarms.settings import thresholds_of
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Mount
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import AlarmRule
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.operator_actions import OperatorCommand
from support.random_conditions import TARGETS
from support.random_rules import RandomRules
from support.random_scenes import SETTING, RandomScene

LENS = replace(CameraModel.with_focal_length(600.0, 640, 480), focal_relative_sigma=0.01)
OUTPUTS = (
    LevelOutput(name="motor", rise_per_s=2.0, fall_per_s=4.0),
    LevelOutput(name="lamp", safe_level=0.3, combine="max"),
    BaseOutput(name="base", combine="most_restrictive"),
)


class RandomRun(Struct, frozen=True, kw_only=True):
    """Rules, and what they are judged by, cycle by cycle."""

    plan: Plan
    observations: tuple[Observation, ...]


def random_run(seed: int, *, is_aimed: bool = False) -> RandomRun:
    """Return a run at 1 to 60 fps, with σ from 0 to 0.5 m, outliers, gaps, operator commands, and chains of rules.

    Args:
        seed: The same seed gives the same run.
        is_aimed: Aim at alarms that give up (policies ``clear`` and ``assert``) while others depend on them: compounds
            about two targets of which one stands in a deadband while the other is out of sight.
    """
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    rules = RandomRules(rng, is_aimed=is_aimed).some()
    fps = rng.choice((1, 5, 10, 30, 60))
    safety = Safety(max_frame_age_s=max(0.2, 2.5 / fps), good_frames=2)
    names = tuple(rule.name for rule in rules if isinstance(rule, AlarmRule))
    seen = RandomScene(rng, fps, names, is_aimed=is_aimed).observations(60 if is_aimed else 100)
    mount = rng.choice((Mount(), Mount(x_m=0.1, y_m=-0.05, yaw_rad=0.2)))
    viewpoint = Viewpoint(height_m=rng.choice((None, 0.5)), tilt_rad=0.1, lens=LENS, mount=mount)
    plan = Plan(targets=TARGETS, rules=rules, outputs=OUTPUTS, safety=safety, viewpoint=viewpoint)
    return RandomRun(plan=plan, observations=tuple(seen))


def with_settings(run: RandomRun, seed: int) -> RandomRun:
    """Return the same run with operators who move thresholds every few cycles, and let rules be observed only."""
    rng = random.Random(seed)  # noqa: S311 - the same run each time
    keys = {rule.name: [*thresholds_of(rule)] for rule in run.plan.rules if isinstance(rule, AlarmRule)}

    def command() -> OperatorCommand:
        name = rng.choice([*keys])
        key = rng.choice(keys[name] or [""])
        value = rng.choice((rng.uniform(0.3, 3.0), rng.uniform(-0.5, 1.0)))
        return OperatorCommand(id="2", action=rng.choice(SETTING), rule=name, key=key, value=value, by="Zoe")

    observations = (
        replace(each, operator_commands=(*each.operator_commands, command())) if keys and rng.random() < 0.2 else each
        for each in run.observations
    )
    return replace(run, observations=tuple(observations))


def first_difference(run: RandomRun) -> tuple[int, Decision, Decision] | None:
    """Return the first cycle in which evaluating alarms that surely stay as they are would change something.

    Both decisions are given: as they are made, and with every alarm evaluated in full.
    """
    short = full = initial_state(run.plan)
    for cycle, observation in enumerate(run.observations):
        short, decision = decide(short, observation)
        with patch.object(alarm, "_stays", lambda *_: False):
            full, expected = decide(full, observation)
        if decision != expected or dict(decision.reasons) != dict(expected.reasons):
            return cycle, decision, expected
    return None
