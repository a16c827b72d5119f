"""A configuration made ready for proof: rules, safety and base driver as they are, everything around them staged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, cast

from msgspec import Struct
from msgspec.structs import replace

from scenario.prove.faults import LASTS_S, NEEDS_FIRMWARE, UNPLUGS
from scenario.prove.staged_camera import StagedCameraOptions
from scenario.prove.watch import MotionLimits
from stadimeter.app.service import safe_lines
from stadimeter.app.watchdog import limit_s
from stadimeter.config import plugins
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, load_driver
from stadimeter.config.rule_test_tables import PathPoint
from stadimeter.core.plan import BaseOutput
from stadimeter.core.rule import FollowRule
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.rule_tests import SyntheticTrack, sensor_models

# The target is this much too far away, or the most of it at which it is found; and a little to the right.
_AHEAD_M = (1.5, 1.0, 0.5, 0.2)

# It is this much nearer, and not below half its distance, in the trial without a fault: the base backs up.
_NEAR_M = (-0.8, -0.5, -0.2)
_BEARING_RAD = 0.05

# For a base that only turns it is so far off that a search turns at once, to both sides and up and down in turn, lest
# the travel end. At every moment at which a fault begins it has turned at full speed for a while.
_SWAY_RAD, _SWAYS_FIRST_S, _SWAYS_EVERY_S, _SWAYS_UNTIL_S = 0.3, 2.1, 1.5, 30.0

# What stands in for drivers that reach beyond this computer, by section.
_STAND_INS = {
    "actuators": plugins.ACTUATORS,
    "sensors": plugins.SENSORS,
    "status_led": plugins.ACTUATORS,
    "messenger": plugins.MESSENGERS,
    "notifiers": plugins.NOTIFIERS,
}


class StagedConfiguration(Struct, frozen=True, kw_only=True):
    """What every trial of a proof begins with.

    Attributes:
        configuration: With a staged camera, the emulated base, and simulated drivers for everything else.
        base: The base, emulated.
        port: The name of its emulated port; empty for a base without one.
        sketch_stops_s: The time-out that the configuration says the base's own program has; None where a command sets
            it, so that the emulator has its own until then, or nothing is said.
        safe_lines: What the watchdog process does to make the base safe; empty where it can do nothing.
        watchdog_s: How old the data may grow on which the base acts, before it kills a program that hangs.
        seen: What measures each target in a picture that shows the followed one, and no other.
        hidden: What does in a picture that shows none.
        near: What does where the followed one is so near that the base backs up; empty for one that never does.
    """

    configuration: Configuration
    base: DriverChoice
    port: str
    sketch_stops_s: float | None
    limits: MotionLimits
    safe_lines: tuple[str, ...]
    watchdog_s: float
    seen: tuple[SyntheticTrack, ...]
    hidden: tuple[SyntheticTrack, ...]
    near: tuple[SyntheticTrack, ...]

    def alphabet(self) -> tuple[str, ...]:
        """Return the faults that this configuration can suffer."""
        firmware = _firmware(self.port)
        impossible: frozenset[str] = frozenset()
        if self.configuration.messenger is None:
            impossible |= {"lose-broker"}
        if not self.limits.watches_near:
            impossible |= {"silence-sensors"}
        if not self.safe_lines:
            impossible |= {"kill-watchdog"}
        if self.port != "emulated-pca9685":
            impossible |= {"hold-bus"}
        if firmware is None:
            impossible |= NEEDS_FIRMWARE if self.base.driver == "simulated" else NEEDS_FIRMWARE | UNPLUGS
        if not hasattr(firmware, "reset"):
            impossible |= {"reset-base"}
        return tuple(fault for fault in LASTS_S if fault not in impossible)


def stage(configuration: Configuration) -> StagedConfiguration:
    """Make a configuration ready for proof. Nothing is opened.

    Raises:
        ConfigError: No base follows a target, the base has no emulator, or there is no camera model.
    """
    follow = next((each for each in configuration.plan.rules if isinstance(each, FollowRule)), None)
    if configuration.base is None or follow is None:
        raise _unfit(configuration, "base", "nothing drives: a proof needs a [base] and a rule with follow")
    base, port = _emulated(configuration, configuration.base)
    # The ball of the simulated world is beyond the reach of any range sensor.
    far = {"at": "0 s", "x": "1000 m", "y": "0 m"}
    world = load_driver(plugins.WORLDS, "simulated").model_validate({"path": [far]})
    drivers = {at: _stand_in(at, choice) for at, choice in configuration.drivers.items() if at[0] != "buttons"}
    drivers |= {
        ("camera",): DriverChoice(name="camera", driver="staged", options=StagedCameraOptions()),
        ("base",): base,
        ("world",): DriverChoice(name="world", driver="simulated", options=world),
    }
    return StagedConfiguration(
        configuration=replace(configuration, drivers=drivers, button_tables={}),
        base=base,
        port=port,
        sketch_stops_s=_sketch_time_out_s(base, port),
        limits=_limits(configuration, base, follow),
        safe_lines=tuple(safe_lines(configuration.base)) if not configuration.base.is_simulated else (),
        watchdog_s=limit_s(configuration),
        seen=_tracks(configuration, follow, follow.target, sways=base.options.only_turns),
        hidden=_tracks(configuration, follow, ""),
        near=_tracks(configuration, follow, follow.target, ahead_m=_NEAR_M) if _backs_up(base, follow) else (),
    )


def _backs_up(base: DriverChoice, follow: FollowRule) -> bool:
    return follow.reverse_max_mps > 0 and not base.options.only_turns


def _unfit(configuration: Configuration, key: str, message: str, hint: str = "") -> ConfigError:
    return ConfigError([Problem(message, file=str(configuration.path), key=key, hint=hint)])


def _emulated(configuration: Configuration, base: DriverChoice) -> tuple[DriverChoice, str]:
    """Return the base behind the emulator of its protocol, and the name of that port."""
    if base.driver == "simulated":
        return base, ""
    port = base.options.emulator or f"emulated-{base.driver}"
    if port not in plugins.driver_names(plugins.PORTS) or "port" not in type(base.options).model_fields:
        hint = f"these are emulated: {', '.join(plugins.driver_names(plugins.PORTS))}"
        raise _unfit(configuration, "base.driver", f"there is no emulator of the base '{base.driver}'", hint)
    return replace(base, options=base.options.model_copy(update={"port": port})), port


def _stand_in(at: tuple[str | int, ...], choice: DriverChoice) -> DriverChoice:
    group = _STAND_INS.get(str(at[0]))
    if group is None or choice.driver == "simulated":
        return choice
    return DriverChoice(name=choice.name, driver="simulated", options=load_driver(group, "simulated")())


def _tracks(
    configuration: Configuration,
    follow: FollowRule,
    shown: str,
    *,
    sways: bool = False,
    ahead_m: Sequence[float] = _AHEAD_M,
) -> tuple[SyntheticTrack, ...]:
    """Return what measures each target, of which one shows: always as far ahead, as if it led the robot on."""
    sensors = sensor_models(configuration)
    places_m = [max(0.5 * follow.distance_m, follow.distance_m + each) for each in ahead_m]
    distance_m = next(filter(sensors[follow.target].is_found, places_m), places_m[-1])
    path = [PathPoint(at_s=0.0, distance_m=distance_m, bearing_rad=_BEARING_RAD)]
    if sways:
        path = list(_swaying(distance_m))
    return tuple(
        SyntheticTrack(target=name, path=path if name == shown else (), sensor=sensor, seed=1, noise=0.0)
        for name, sensor in sensors.items()
    )


def _swaying(distance_m: float) -> Iterator[PathPoint]:
    """Yield where a target is that changes sides again and again, at once each time."""
    begin_s, off_rad = 0.0, _SWAY_RAD
    while begin_s < _SWAYS_UNTIL_S:
        end_s = begin_s + (_SWAYS_EVERY_S if begin_s else _SWAYS_FIRST_S)
        for at_s in (begin_s + 1e-3, end_s):
            yield PathPoint(at_s=at_s, distance_m=distance_m, bearing_rad=off_rad, elevation_rad=off_rad)
        begin_s, off_rad = end_s, -off_rad


def _limits(configuration: Configuration, base: DriverChoice, follow: FollowRule) -> MotionLimits:
    plan = configuration.plan
    output = next(each for each in plan.outputs if isinstance(each, BaseOutput) and each.name == base.name)
    half_track_m = getattr(base.options, "track_width", 0.2) / 2
    commanded_mps = output.linear_max_mps + output.angular_max_radps * half_track_m
    cruise_mps = min(follow.linear_max_mps, output.linear_max_mps)
    is_turned = base.options.only_turns
    return MotionLimits(
        parts="servos" if is_turned else "wheels",
        stale_s=max(configuration.leases_s[base.name], plan.safety.max_frame_age_s),
        lost_s=plan.tracking.coast_s + plan.safety.max_frame_age_s,
        beyond_s=_own_time_out_s(base),
        fastest=output.angular_max_radps
        if is_turned
        else min(commanded_mps, getattr(base.options, "max_wheel_speed", commanded_mps)),
        half_track_m=None if is_turned else half_track_m,
        cruise=min(follow.angular_max_radps, output.angular_max_radps) if is_turned else cruise_mps,
        linear_mps=output.linear_max_mps,
        angular_radps=output.angular_max_radps,
        gap_s=plan.safety.max_frame_age_s,
        good_frames=plan.safety.good_frames,
        searches=follow.search is not None,
        watches_near=any(each.stop_below is not None for each in configuration.sensor_tables.values()),
        needs_arming=plan.safety.arm != "at-start",
    )


def _own_time_out_s(base: DriverChoice) -> float:
    """Return after how long a base that is left alone stops by itself, as its driver says; infinite for never."""
    if isinstance(base.options, plugins.StopsByItself):
        return base.options.stops_by_itself_after_s()
    return float(getattr(base.options, "auto_stop", 0.0) or math.inf)


def _firmware(port: str) -> Any:
    """Return the emulated firmware behind a port; None for a board without, and for a base without a port."""
    return getattr(load_driver(plugins.PORTS, port), "firmware", None) if port else None


def _sketch_time_out_s(base: DriverChoice, port: str) -> float | None:
    """Return the time-out that only the configuration knows, since the program of the board has it built in."""
    firmware, options = _firmware(port), cast("Any", base.options)
    if firmware is None or firmware.takes_timeout or "auto_stop" not in type(options).model_fields:
        return None
    return float(options.auto_stop or math.inf)
