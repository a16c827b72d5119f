"""What a device lets a fleet change: a file of its own, which is never sent; and how two configurations differ."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from stadimeter.app.control.reloading import needs_restart
from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.driver_tables import validate
from stadimeter.config.findings import Finding, problems
from stadimeter.config.loader import Configuration
from stadimeter.config.models import Section
from stadimeter.config.toml_source import parse_toml, read_toml
from stadimeter.config.units import FilePath, validation_context
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES
from stadimeter.core.conditions.compounds import depends_on
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, conditions_of
from stadimeter.errors import ConfigError

# Beside the configuration.
POLICY = "fleet.toml"

# What cannot make anything move, nor move it otherwise. Of the rest, some does so only where there is a base.
_NEVER_MOVES = frozenset({"[messenger]", "[notifiers]", "[web]", "[recording]", "[black_box]"})
_MOVES_WITH_BASE = frozenset({"[camera]", "[camera.model]", "[targets]", "[tracking]", "[world]"})

_SECTIONS = re.compile(r"^(?=[ \t]*\[)", re.MULTILINE)
_HEADER = re.compile(r"""[ \t]*\[{1,2}[ \t]*["']?([\w-]+)""")


class FleetPolicy(Section):
    """The keys of the file ``fleet.toml``."""

    allowed_signers: FilePath
    """Whose signatures count, in the format of OpenSSH; see ALLOWED SIGNERS in ``man ssh-keygen``."""
    change: Literal["none", "rules", "all"] = "rules"
    """What a fleet may change: nothing (configurations are only tried), rules and their tests, or every section."""
    replay: Literal["if-recorded", "required"] = "if-recorded"
    """Whether a device without a recording of its own takes a configuration."""
    recording: FilePath | None = None
    """A journal or recording of this device, or a folder of them. By default what its run keeps by itself, else the
    folder of those begun by request."""
    state: FilePath | None = None
    """The folder in which the device remembers what it was sent. By default that of the configuration."""

    def file_beside(self, configuration: Path, kind: str) -> Path:
        """Return where the device remembers something of a configuration."""
        return (self.state or configuration.resolve().parent) / f"{configuration.stem}.fleet-{kind}"


def load_policy(path: Path) -> FleetPolicy:
    """Read the policy of a device; raises ConfigError if it is not there or is wrong."""
    hint = 'write one that says at least whom to believe: allowed_signers = "allowed_signers"'
    source = read_toml(path, CONFIGURATION_MAX_BYTES, hint)
    findings: list[Finding] = []
    policy = validate(FleetPolicy, source.table, (), validation_context(path), findings)
    if policy is None or findings:
        raise ConfigError(problems(findings, str(path), source.spans))
    return policy


class MotionPermit:
    """A permission, given on the device, to apply a single configuration that moves something otherwise.

    It goes by the time since the boot, and ends with it: a clock that was set wrong does not lengthen it.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def give(self, seconds: float) -> None:
        """Permit it for that long; `OSError` if that cannot be written."""
        write_atomically(self._file, f"{_boot_id()} {_since_boot_s() + seconds}".encode())

    def stands(self) -> bool:
        """Return whether it was given and not used yet."""
        try:
            boot_id, until_s = self._file.read_text().split()
            return boot_id == _boot_id() and _since_boot_s() < float(until_s)
        except (OSError, ValueError):
            return False

    def use(self) -> None:
        """Note that it was used."""
        self._file.unlink(missing_ok=True)


def _boot_id() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def _since_boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def compose(own: str, desired: str) -> str:
    """Return the text of a device's configuration with the sections that are desired in place of its own.

    A desired text that has every section is taken as it is. The camera, the lens and the broker's login differ from
    device to device, so most leave them out.

    Raises:
        ConfigError: Either is no TOML, or the sections of the device's own file cannot be separated.
    """
    theirs, ours = parse_toml(desired, "the desired configuration").table, parse_toml(own, "the configuration").table
    if ours.keys() <= theirs.keys():
        return desired
    parts = ((_HEADER.match(part), part) for part in _SECTIONS.split(own))
    kept = [part for header, part in parts if header and header[1] not in theirs]
    text = f"{desired.rstrip()}\n\n{''.join(kept).rstrip()}\n"
    try:
        is_sound = tomllib.loads(text) == {**ours, **theirs}
    except tomllib.TOMLDecodeError:
        is_sound = False
    if not is_sound:  # a key before the first header, or a line of a text that looks like a header
        raise ConfigError("the sections of the device's own file cannot be separated; begin each with its header")
    return text


def changed_settings(old: Configuration, new: Configuration) -> tuple[str, ...]:
    """Return the sections that differ, such as ``[camera]``; rules and their tests are none of them."""
    plans = [(f"[{name}]", getattr(old.plan, name), getattr(new.plan, name)) for name in ("tracking", "safety")]
    plans.append(("[figures]", old.plan.named_figures, new.plan.named_figures))
    live = [name for name, before, after in (*plans, ("[web]", old.web, new.web)) if before != after]
    return tuple(dict.fromkeys([*needs_restart(old, new), *live]))


def changed_motion(old: Configuration, new: Configuration) -> tuple[str, ...]:
    """Return what may make something move that did not, or move otherwise: sections, and rules by their names.

    Without a base, those are the outputs and what stops them. With one, it is nearly every section, and every rule that
    asks something of the base or that such a rule depends on.
    """
    has_base = any(isinstance(output, BaseOutput) for output in (*old.plan.outputs, *new.plan.outputs))
    harmless = _NEVER_MOVES if has_base else _NEVER_MOVES | _MOVES_WITH_BASE
    settings = [name for name in changed_settings(old, new) if name not in harmless]
    before, after = _moving_rules(old.plan), _moving_rules(new.plan)
    rules = [name for name in {**before, **after} if before.get(name) != after.get(name)]
    return (*settings, *(f"rule '{name}'" for name in rules))


def _moving_rules(plan: Plan) -> dict[str, AnyRule]:
    """Return the rules that move a base, and those that they depend on, by name."""
    bases = {output.name for output in plan.outputs if isinstance(output, BaseOutput)}
    by_name = {rule.name: rule for rule in plan.rules}
    waiting = [rule for rule in plan.rules if bases.intersection(_outputs_of(rule))]
    found: dict[str, AnyRule] = {}
    while waiting:
        rule = waiting.pop()
        if rule.name not in found:
            found[rule.name] = rule
            waiting += [by_name[name] for name in _names_in(rule) if name in by_name]
    return found


def _outputs_of(rule: AnyRule) -> Iterator[str | None]:
    yield rule.output
    if isinstance(rule, AlarmRule):
        yield from (step.output for step in rule.escalation)


def _names_in(rule: AnyRule) -> Iterator[str]:
    for condition in conditions_of(rule):
        yield from depends_on(condition)
