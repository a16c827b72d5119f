"""Loads a configuration, or raises one error that lists everything that is wrong with it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stadimeter.config.cross_checks import error_findings, warning_findings
from stadimeter.config.draft import BASE_NAME, Draft, read_draft
from stadimeter.config.driver_choice import DriverChoice
from stadimeter.config.driver_tables import CAMERA, read_driver_table
from stadimeter.config.findings import problems
from stadimeter.config.paths import validation_context
from stadimeter.config.toml_lines import key_places, syntax_error
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.plan import Output, Plan
from stadimeter.errors import ConfigError, Problem

__all__ = ["Configuration", "DriverChoice", "load_camera_choice", "load_configuration"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """A configuration without errors.

    Attributes:
        path: The file.
        text: What stood in it.
        plan: What it declares, as the core sees it.
        camera: The camera's driver.
        camera_model: The lens, or None if it names none; then it has no rules.
        targets: The detector of each target, in the order of the file.
        actuators: The driver of each actuator, in the order of the file.
        base: The base's driver, or None.
        messenger: The messenger's driver, or None.
        world: The simulated world, or None.
        leases_s: For each output how old the frame behind a command may grow, in seconds.
        warnings: What is allowed and hardly meant.
    """

    path: Path
    text: str
    plan: Plan
    camera: DriverChoice
    camera_model: CameraModel | None
    targets: tuple[DriverChoice, ...]
    actuators: tuple[DriverChoice, ...]
    base: DriverChoice | None
    messenger: DriverChoice | None
    world: DriverChoice | None
    leases_s: Mapping[str, float]
    warnings: tuple[Problem, ...]


def load_configuration(path: Path) -> Configuration:
    """Load a configuration and the camera file that it names.

    Args:
        path: The TOML file.

    Returns:
        The configuration.

    Raises:
        ConfigError: It lists every problem, in the order of the file.
    """
    text = _read(path)
    draft = read_draft(_parse(path, text), path)
    places = key_places(text)
    findings = [*draft.findings, *error_findings(draft)]
    found = [*problems(findings, str(path), places), *draft.file_problems]
    if found or draft.camera is None:
        raise ConfigError(found)
    return Configuration(
        path=path,
        text=text,
        plan=_plan(draft),
        camera=draft.camera,
        camera_model=draft.camera_model,
        targets=tuple(draft.targets),
        actuators=tuple(draft.actuators),
        base=draft.base,
        messenger=draft.messenger,
        world=draft.world,
        leases_s=_leases(draft),
        warnings=problems(warning_findings(draft), str(path), places),
    )


def load_camera_choice(path: Path) -> DriverChoice:
    """Load the camera of a configuration, and nothing else: not its camera file, which may not be there yet.

    Args:
        path: The TOML file.

    Returns:
        The camera's driver.

    Raises:
        ConfigError: It lists every problem of the section ``[camera]``.
    """
    text = _read(path)
    table = _parse(path, text).get("camera")
    if not isinstance(table, Mapping):
        raise ConfigError([Problem("the section [camera] is missing", str(path), hint='add one: driver = "opencv"')])
    read = read_driver_table(CAMERA, ("camera",), table, validation_context(path))
    if read.choice is None or read.findings:
        raise ConfigError(problems(read.findings, str(path), key_places(text)))
    return read.choice


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except FileNotFoundError as error:
        raise ConfigError([Problem("there is no such file", str(path))]) from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ConfigError([Problem("this is not UTF-8 text", str(path), line, hint="is it a TOML file?")]) from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError([Problem(f"the file cannot be read: {reason}", str(path))]) from error


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message, line = syntax_error(error, text)
        problem = Problem(f"this is not valid TOML: {message}", str(path), line, hint=_syntax_hint(message))
        raise ConfigError([problem]) from error


def _syntax_hint(message: str) -> str:
    if message.startswith(("Invalid value", "Expected newline")):
        return 'text needs quotes, such as "10 ft"; the values without are numbers, true and false'
    if message.startswith("Cannot"):
        return "the same key or section stands in the file twice; keep one"
    return ""


def _plan(draft: Draft) -> Plan:
    targets = draft.names("targets")
    outputs: list[Output] = [table.to_plan(name) for name, table in draft.actuator_tables.items()]
    if draft.base_table is not None:
        outputs.append(draft.base_table.to_plan(BASE_NAME))
    return Plan(
        targets=targets,
        rules=tuple(rule.to_plan(name, rule.target or targets[0]) for name, rule in draft.rules.items()),
        outputs=tuple(outputs),
        tracking=draft.tracking.to_plan(),
        safety=draft.safety.to_plan(),
    )


def _leases(draft: Draft) -> dict[str, float]:
    leases_s = {name: table.lease for name, table in draft.actuator_tables.items()}
    if draft.base_table is not None:
        leases_s[BASE_NAME] = draft.base_table.lease
    return leases_s
