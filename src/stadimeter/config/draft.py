"""Reads every part of a configuration for itself, so that one broken part does not hide what is wrong in another."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stadimeter.config import driver_tables, models
from stadimeter.config.camera_file import camera_model_from_table, load_camera_model
from stadimeter.config.driver_tables import CommonT, DriverKind, DriverTable, read_driver_table, validate
from stadimeter.config.findings import MOST_EXPLAINED, Finding, did_you_mean_or_list, shown
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.rules.compiled import CompiledRule, compile_rules
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.toml_source import UNREADABLE, Texts
from stadimeter.config.units import path_from, validation_context
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError, Problem

if TYPE_CHECKING:
    from stadimeter.config.rule_test_tables import RuleTestTable

BASE_NAME = "base"
"""The name of the base in rules."""

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_TAKEN: dict[str, set[str]] = {
    "targets": {"camera"},
    "actuators": {"camera", BASE_NAME},
    "buttons": set(),
    "notifiers": set(),
    "rules": {"safety", "safe", "operator"},
}
"""Names that mean something else in events and traces."""


@dataclass(slots=True, kw_only=True)
class Draft:
    """A configuration as far as it could be read.

    Attributes:
        table: The whole file as the TOML parser read it.
        file_problems: What is wrong in a camera file that it names.
        targets: The targets that could be read.
        actuators: The actuators whose driver could be read.
        base: The base, if its driver could be read.
        notifiers: The notifiers whose driver could be read; so are buttons.
        actuator_tables: What every actuator has, by name.
        rules: The rules that could be read, by name.
        tests: The tests that could be read, by their position in the file.
        compiled: The same rules as the core runs them, each beside its table.
    """

    table: Mapping[str, Any]
    findings: list[Finding] = field(default_factory=list)
    file_problems: list[Problem] = field(default_factory=list)
    camera: DriverChoice | None = None
    camera_model: CameraModel | None = None
    targets: list[DriverChoice] = field(default_factory=list)
    actuators: list[DriverChoice] = field(default_factory=list)
    base: DriverChoice | None = None
    status_led: DriverChoice | None = None
    buttons: list[DriverChoice] = field(default_factory=list)
    button_tables: dict[str, models.ButtonTable] = field(default_factory=dict)
    messenger: DriverChoice | None = None
    notifiers: list[DriverChoice] = field(default_factory=list)
    world: DriverChoice | None = None
    actuator_tables: dict[str, models.ActuatorTable] = field(default_factory=dict)
    base_table: models.BaseTable | None = None
    tracking: models.TrackingTable = field(default_factory=models.TrackingTable)
    safety: models.SafetyTable = field(default_factory=models.SafetyTable)
    web: models.WebTable | None = None
    rules: dict[str, RuleTable] = field(default_factory=dict)
    tests: dict[int, RuleTestTable] = field(default_factory=dict)
    compiled: tuple[CompiledRule, ...] = ()
    renamed: tuple[Finding, ...] = ()

    def names(self, section: str) -> tuple[str, ...]:
        """Return the names that a section such as ``actuators`` declares, in order, even of what could not be read."""
        return tuple(self.tables(section))

    def tables(self, section: str) -> dict[str, Mapping[str, Any]]:
        """Return the tables of a section such as ``rules`` by name, as they were written; only what is a table."""
        tables = self.table.get(section, {})
        if not isinstance(tables, Mapping):
            return {}
        return {name: table for name, table in tables.items() if isinstance(table, Mapping)}

    def parts(self) -> Iterator[tuple[tuple[str, ...], DriverChoice]]:
        """Go through every driver that could be read, each behind the path of its table."""
        yield from parts_of(self)


def parts_of(whole: Any) -> Iterator[tuple[tuple[str, ...], DriverChoice]]:
    """Go through the drivers of a draft or a configuration, each behind the path of its table."""
    for section in (
        "camera",
        "base",
        "messenger",
        "world",
        "targets",
        "actuators",
        "status_led",
        "buttons",
        "notifiers",
    ):
        found = getattr(whole, section)
        if isinstance(found, list | tuple):
            yield from (((section, choice.name), choice) for choice in found)
        elif found is not None:
            yield (section,), found


def read_draft(table: Mapping[str, Any], file: Path, *, with_tests: bool = True, texts: Texts | None = None) -> Draft:
    """Read every part of a configuration.

    Args:
        table: The file as the TOML parser read it.
        file: The file; paths are relative to its folder.
        texts: What to read in place of other files.
    """
    reader = _Reader(table, file, texts)
    draft = reader.read()
    if with_tests:
        reader.read_tests()
    return draft


class _Reader:
    """Fills a draft, part by part."""

    def __init__(self, table: Mapping[str, Any], file: Path, texts: Texts | None) -> None:
        self.texts = texts
        self.draft = Draft(table=table)
        self.context = validation_context(file)
        self.folder = file.parent

    def read(self) -> Draft:
        self._sections()
        self._camera()
        self._targets()
        self._outputs()
        self._panel()
        self._messenger_and_world()
        self._notifiers()
        self._settings()
        self._rules()
        return self.draft

    def _sections(self) -> None:
        unknown = [section for section in self.draft.table if section not in models.SECTIONS]
        for section in unknown[:MOST_EXPLAINED]:
            hint = did_you_mean_or_list(section, models.SECTIONS)
            self._found((section,), f"unknown section '{section}'", hint, "unknown-key")
        if left := unknown[MOST_EXPLAINED:]:
            self._found((left[0],), f"from here on, {len(left)} more sections are unknown", code="unknown-key")

    def _camera(self) -> None:
        read = self._single("camera", driver_tables.CAMERA)
        if read is not None:
            self.draft.camera = read.choice
            self._camera_model(read.common.model if read.common else None)
        elif "camera" not in self.draft.table:
            self._found(("camera",), "the section [camera] is missing", 'add one, such as driver = "opencv"')

    def _camera_model(self, value: object) -> None:
        try:
            if isinstance(value, str):
                self._camera_file(path_from(self.folder, value))
            elif isinstance(value, Mapping):
                self.draft.camera_model = camera_model_from_table(dict(value))
            elif value is not None:
                self._found(("camera", "model"), f"{shown(value)} is neither a camera file nor a table")
        except ConfigError as error:
            for problem in error.problems:
                key = tuple(problem.key.split(".")) if problem.key else ()
                self._found(("camera", "model", *key), problem.message, problem.hint)
        except ValueError as error:
            self._found(("camera", "model"), str(error))

    def _camera_file(self, file: Path) -> None:
        try:
            self.draft.camera_model = load_camera_model(file, self.texts)
        except ConfigError as error:
            for problem in error.problems:
                if problem.code == UNREADABLE:
                    self._found(("camera", "model"), f"the camera file {file}: {problem.message}", problem.hint)
                else:
                    self.draft.file_problems.append(problem)

    def _targets(self) -> None:
        for name, table in self._named("targets"):
            read = self._driver(driver_tables.TARGET, ("targets", name), table)
            self.draft.targets += [read.choice] if read.choice else []
        if not self.draft.table.get("targets"):
            self._found(("targets",), "there is no target", "add one, such as [targets.ball]")

    def _outputs(self) -> None:
        for name, table in self._named("actuators"):
            read = self._driver(driver_tables.ACTUATOR, ("actuators", name), table)
            self.draft.actuators += [read.choice] if read.choice else []
            if read.common is not None:
                self.draft.actuator_tables[name] = read.common
        base = self._single("base", driver_tables.BASE)
        if base is not None:
            self.draft.base, self.draft.base_table = base.choice, base.common

    def _panel(self) -> None:
        light = self._single("status_led", driver_tables.STATUS_LED)
        self.draft.status_led = light.choice if light else None
        for name, table in self._named("buttons"):
            read = self._driver(driver_tables.BUTTON, ("buttons", name), table)
            self.draft.buttons += [read.choice] if read.choice else []
            if read.common is not None:
                self.draft.button_tables[name] = read.common

    def _messenger_and_world(self) -> None:
        messenger = self._single("messenger", driver_tables.MESSENGER)
        world = self._single("world", driver_tables.WORLD)
        self.draft.messenger = messenger.choice if messenger else None
        self.draft.world = world.choice if world else None

    def _notifiers(self) -> None:
        for name, table in self._named("notifiers"):
            read = self._driver(driver_tables.NOTIFIER, ("notifiers", name), table)
            self.draft.notifiers += [read.choice] if read.choice else []

    def _settings(self) -> None:
        tracking = self._validated(models.TrackingTable, ("tracking",), self._table("tracking") or {})
        safety = self._validated(models.SafetyTable, ("safety",), self._table("safety") or {})
        self.draft.tracking = tracking or self.draft.tracking
        self.draft.safety = safety or self.draft.safety
        web = self._table("web")
        self.draft.web = None if web is None else self._validated(models.WebTable, ("web",), web)

    def _rules(self) -> None:
        for name, table in self._named("rules"):
            rule = self._validated(RuleTable, ("rules", name), table)
            if rule is not None:
                self.draft.rules[name] = rule
        draft = self.draft
        draft.compiled = compile_rules(draft.rules, draft.tables("rules"), draft.names("targets"))

    def read_tests(self) -> None:
        tables = self.draft.table.get("tests", [])
        if not isinstance(tables, list):
            self._found(("tests",), "'tests' is not a list of tables", "write it as [[tests]]")
            return
        if not tables:
            return
        from stadimeter.config.rule_test_tables import RuleTestTable  # noqa: PLC0415 - most runs have no tests

        for position, table in enumerate(tables):
            at = ("tests", position)
            if not isinstance(table, Mapping):
                self._found(at, f"{shown(table)} is not a table", "write it below [[tests]]")
            elif (test := self._validated(RuleTestTable, at, table)) is not None:
                self.draft.tests[position] = test

    def _single(self, section: str, kind: DriverKind[CommonT]) -> DriverTable[CommonT] | None:
        table = self._table(section)
        return None if table is None else self._driver(kind, (section,), table)

    def _driver(self, kind: DriverKind[CommonT], at: tuple[str, ...], table: Mapping[str, Any]) -> DriverTable[CommonT]:
        read = read_driver_table(kind, at, table, self.context)
        self.draft.findings += read.findings
        return read

    def _validated(self, model: type[CommonT], at: KeyPath, table: Mapping[str, Any]) -> CommonT | None:
        return validate(model, table, at, self.context, self.draft.findings)

    def _named(self, section: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
        tables = self._table(section, f"[{section}.NAME]") or {}
        for name, table in tables.items():
            if not isinstance(table, Mapping):
                self._found((section, name), f"'{name}' is not a table", f"write it below [{section}.NAME]")
            elif not _NAME.fullmatch(name) or name in _TAKEN[section]:
                why = "the program uses it itself" if name in _TAKEN[section] else "use letters, digits, - and _ only"
                self._found((section, name), f"'{name}' cannot be a name here", why)
            else:
                yield name, table

    def _table(self, section: str, form: str = "") -> Mapping[str, Any] | None:
        table = self.draft.table.get(section)
        if table is None or isinstance(table, Mapping):
            return table
        self._found((section,), f"'{section}' is not a table", f"write it as {form or f'[{section}]'}")
        return None

    def _found(self, path: KeyPath, message: str, hint: str = "", code: str = "bad-value") -> None:
        self.draft.findings.append(Finding(path, message, hint, code))
