"""The tables that name a driver: what belongs to every driver of the kind, and what is the driver's own."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from msgspec import Struct
from pydantic import BaseModel, ValidationError

from stadimeter.config import models, plugins
from stadimeter.config.findings import Finding, did_you_mean, findings_of, format_value, known_keys
from stadimeter.config.plugins import DriverChoice, DriverOptions
from stadimeter.config.toml_lines import KeyPath
from stadimeter.errors import DriverError

ModelT = TypeVar("ModelT", bound=BaseModel)


class DriverKind(Struct, frozen=True, kw_only=True):
    """A kind of part.

    Attributes:
        group: The entry points that its drivers are found in.
        common: The keys that every driver of the kind has; none of most.
        default: The driver where none is named; empty if one must be.
        is_named: Whether there may be several, each a table with a name of its own.
    """

    group: str
    common: type[models.Section] = models.Section
    key: str = "driver"
    default: str = ""
    is_named: bool = False


CAMERA = DriverKind(group=plugins.CAMERAS, common=models.CameraTable)
BASE = DriverKind(group=plugins.BASES, common=models.BaseTable)
MESSENGER = DriverKind(group=plugins.MESSENGERS)
WORLD = DriverKind(group=plugins.WORLDS, default="simulated")
TARGET = DriverKind(group=plugins.DETECTORS, common=models.TargetTable, key="detector", is_named=True)
ACTUATOR = DriverKind(group=plugins.ACTUATORS, common=models.ActuatorTable, is_named=True)

# The kind of each section that names drivers.
DRIVER_KINDS: Mapping[str, DriverKind] = {
    "camera": CAMERA,
    "second_camera": DriverKind(group=plugins.CAMERAS, common=models.SecondCameraTable),
    "messenger": MESSENGER,
    "world": WORLD,
    "targets": TARGET,
    "actuators": ACTUATOR,
    "base": BASE,
    "sensors": DriverKind(group=plugins.SENSORS, common=models.SensorTable, is_named=True),
    "status_led": DriverKind(group=plugins.ACTUATORS),
    "buttons": DriverKind(group=plugins.BUTTONS, common=models.ButtonTable, is_named=True),
    "notifiers": DriverKind(group=plugins.NOTIFIERS, is_named=True),
}


def read_driver_table(
    kind: DriverKind, at: KeyPath, table: Mapping[str, Any], context: Mapping[str, Any], findings: list[Finding]
) -> tuple[DriverChoice | None, models.Section | None]:
    """Read a table that names a driver.

    Args:
        at: The table's path; its last key is the part's name.
        findings: What is wrong in it is added here.

    Returns:
        The driver with its options, and the keys that every driver of the kind has; None for what cannot be used.
    """
    common_keys = known_keys(kind.common)
    common_part = {key: value for key, value in table.items() if key in common_keys}
    own_part = {key: value for key, value in table.items() if key not in (*common_keys, kind.key)}
    common = validate(kind.common, common_part, at, context, findings)
    driver, model = _driver(kind, at, table, findings)
    options = validate(model, own_part, at, context, findings, (*common_keys, kind.key)) if model else None
    choice = None if options is None else DriverChoice(name=str(at[-1]), driver=driver, options=options)
    return choice, common


def validate(
    model: type[ModelT],
    table: Mapping[str, Any],
    at: KeyPath,
    context: Mapping[str, Any],
    findings: list[Finding],
    also_known: Iterable[str] = (),
) -> ModelT | None:
    """Check a table against its model.

    Args:
        also_known: Keys that the table may hold besides the model's, for suggestions.

    Returns:
        The model, without what is wrong in the table, so that the rest can still be checked against other tables. None
        if too little is left.
    """
    rest = copy.deepcopy(dict(table))
    is_first_look = True
    while True:
        try:
            return model.model_validate(rest, context=dict(context))
        except ValidationError as error:
            found = list(findings_of(error, model, rest, at, also_known))
        if is_first_look:  # later looks find only what was taken out
            findings += found
        is_first_look = False
        if not all(_take_out(rest, finding.path[len(at) :]) for finding in found):
            return None


def _take_out(table: dict[str, Any], path: KeyPath) -> bool:
    """Take out a key, or the table that misses it; return whether anything is left."""
    holder: Any = table
    for depth, key in enumerate(path):
        if not isinstance(holder, dict):  # an entry of a list: what is written behind it would move up
            return _take_out(table, path[:depth])
        if key not in holder:
            return depth < len(path) - 1 or _take_out(table, path[:depth])
        if depth == len(path) - 1:
            del holder[key]
            return True
        holder = holder[key]
    return False


def _driver(
    kind: DriverKind, at: KeyPath, table: Mapping[str, Any], findings: list[Finding]
) -> tuple[str, type[DriverOptions] | None]:
    driver = table.get(kind.key, kind.default)
    path = (*at, kind.key)
    if not isinstance(driver, str):
        findings.append(Finding(path, f"{format_value(driver)} is not text; put it in quotes", code="bad-value"))
    elif not driver:
        findings.append(_no_driver(kind, path, table))
    else:
        try:
            return driver, plugins.load_driver(kind.group, driver)
        except DriverError as error:
            findings.append(Finding(path, str(error), code="driver"))
    return "", None


def _no_driver(kind: DriverKind, path: KeyPath, table: Mapping[str, Any]) -> Finding:
    similar = next((key for key in table if did_you_mean(key, [kind.key])), None)
    known = f"known are: {', '.join(plugins.driver_names(kind.group))}"
    hint = f"there is '{similar}'; did you mean '{kind.key}'?" if similar else known
    return Finding(path, f"'{kind.key}' is missing", hint, "missing-key")
