"""Parts of a rule that may be changed alone: thresholds, deadbands and delays, and where each is written.

Names follow the keys of `when`, as those of the thresholds that operators set: ``below``, ``between.near``,
``closing_speed.above``, ``any.0.deadband``; and ``on_delay`` and ``off_delay``.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.loader import Configuration
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.toml_lines import KeyPath, set_value
from stadimeter.config.units import parse_any_quantity
from stadimeter.core.alarms.machine import thresholds_of
from stadimeter.core.conditions.compounds import named_leaves
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import ConfigError, Problem


class RuleSetting(Struct, frozen=True, kw_only=True):
    """One that can be changed.

    Attributes:
        value: As it is now, in the SI unit; an on-delay in frames counts as 0.
        unit: The SI unit.
    """

    path: KeyPath
    value: float
    unit: str

    def written(self, value: float) -> str:
        """Return a value as TOML has it; six digits are more than any camera measures."""
        return f'"{value:.6g} {self.unit}"'


def alarm_named(configuration: Configuration, name: str) -> tuple[CompiledRule, AlarmRule]:
    """Return an alarm and its table.

    Raises:
        ConfigError: There is none of that name; of a rule that is none, nothing is to be changed by itself.
    """
    alarms = {rule.name: each for each in configuration.rules if isinstance(rule := each.rule, AlarmRule)}
    alarms |= {each.section: each for each in reversed(alarms.values())}
    found = alarms.get(name)
    if found is None or not isinstance(found.rule, AlarmRule):
        hint = did_you_mean_or_list(name, alarms)
        raise ConfigError([Problem(f"there is no alarm '{name}'", str(configuration.path), hint=hint)])
    return found, found.rule


def settings_of(configuration: Configuration, name: str) -> dict[str, RuleSetting]:
    """Return the settings that may be changed of an alarm, by name; `ConfigError` if there is no such alarm."""
    compiled, alarm = alarm_named(configuration, name)
    written = list(next(compiled.conditions()).leaves())
    found = {
        key: RuleSetting(path=_path_of(written[each.leaf], each.place.key), value=each.value, unit=each.unit)
        for key, each in thresholds_of(alarm).items()
        if not _is_comparison(written[each.leaf])
    }
    found |= _deadbands(alarm, written)
    for key, value_s in (("on_delay", alarm.on_delay.hold_s), ("off_delay", alarm.off_delay_s)):
        found[key] = RuleSetting(path=compiled.at(key), value=value_s, unit="s")
    return found


def with_settings(configuration: Configuration, text: str, name: str, values: Mapping[str, float | str]) -> str:
    """Return the text of a configuration in which an alarm has other settings, and all else is as it was.

    Args:
        text: What `configuration` was loaded from; its own has no secrets.
        values: By their names, in the SI unit, or as they are written, such as ``"60 cm"``.

    Raises:
        ConfigError: There is no such setting, a value has another unit, or it is written in a form of its own.
    """
    known = settings_of(configuration, name)
    for key, value in values.items():
        if key not in known:
            words = f"'{key}' is nothing that can be changed of '{name}' by itself"
            raise ConfigError([Problem(words, str(configuration.path), hint=did_you_mean_or_list(key, known))])
        text = set_value(text, known[key].path, known[key].written(_in_si(known[key], key, value)))
    return text


def _in_si(setting: RuleSetting, key: str, value: float | str) -> float:
    if not isinstance(value, str):
        return value
    try:
        parsed, unit = parse_any_quantity(value)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key=key)]) from error
    if unit != setting.unit:
        raise ConfigError([Problem(f"{value!r} is in {unit}, and '{key}' is in {setting.unit}", key=key)])
    return parsed


def _deadbands(alarm: AlarmRule, written: list[WrittenCondition]) -> dict[str, RuleSetting]:
    """Return the deadbands; those of several conditions begin with where the condition stands, as thresholds do."""
    parts = zip(named_leaves(alarm.condition), written, strict=True)
    limits = [
        (within, leaf, each)
        for (within, leaf), each in parts
        if isinstance(leaf, LimitsCondition) and leaf.section not in {"still", "base"}  # which have none
    ]
    found = {}
    for within, leaf, each in limits:
        key = f"{within if len(limits) > 1 else ''}{f'{leaf.section}.' if leaf.section else ''}deadband"
        found[key] = RuleSetting(path=(*each.limits_path, "deadband"), value=leaf.deadband, unit=leaf.unit)
    return found


def _is_comparison(written: WrittenCondition) -> bool:
    """Check whether it compares two targets: its threshold has one sign in the file and another in the core."""
    return isinstance(written.condition, FigureCondition) and written.condition.is_comparison


def _path_of(written: WrittenCondition, key: str) -> KeyPath:
    """Return where a threshold stands, which may be one of the two of ``between``."""
    path = written.limits_path
    last = key.rpartition(".")[2]
    if "between" not in key:
        return (*path, last)
    table = written.table if path == written.path else written.table[str(path[-1])]
    is_upper = last in {"far", "high"}
    return (*path, "between", int(is_upper)) if "between" in table else (*path, "below" if is_upper else "above")
