"""Reads every part of a configuration for itself, so that one broken part does not hide what is wrong in another."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.config import models
from stadimeter.config.camera_file import camera_model_from_table, load_camera_model
from stadimeter.config.driver_tables import DRIVER_KINDS, ModelT, read_driver_table, validate
from stadimeter.config.findings import Finding, did_you_mean_or_list, format_value
from stadimeter.config.optional_tables import (
    OPTIONAL_TABLES,
    BlackBoxTable,
    MountingTable,
    RecordingTable,
    TimelineTable,
)
from stadimeter.config.plugins import MAX_SEVERAL, DriverChoice, numbered
from stadimeter.config.rules.compiled import CompiledRule, SeveralNames, compile_rules
from stadimeter.config.rules.conditions import FigureTable
from stadimeter.config.rules.tables import GAPS, RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.toml_source import UNREADABLE, Texts
from stadimeter.config.units import path_from, validation_context
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Landmarks
from stadimeter.core.templates import FIELDS
from stadimeter.core.tracking.life_cycle import NearestOf
from stadimeter.errors import ConfigError, Problem

if TYPE_CHECKING:
    from stadimeter.config.rule_test_tables import RuleTest
    from stadimeter.core.stereo_rig import StereoRig

# The name of the base in rules.
BASE_NAME = "base"

# Names that mean something else in events and traces.
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_TAKEN: dict[str, set[str]] = {
    "targets": {"camera", "mounting"},
    "actuators": {"camera", "mounting", BASE_NAME},
    "buttons": set(),
    "sensors": {"camera", "mounting"},
    "notifiers": set(),
    "rules": {"safety", "safe", "operator"},
    "figures": {*FIELDS},
}


class ConfiguredParts(Struct, kw_only=True):
    """The parts of a draft that a configuration without errors has, too.

    Attributes:
        drivers: Each driver whose table could be read, by the path of that table.
        camera_model: The lens of the camera, with a second camera that of the stereo file; None if it names none.
        rig: Both cameras, whose left one is the camera; None without a second camera.
        button_tables: What each button asks of alarms, by its name.
        sensor_tables: Where each range sensor looks, and what it keeps the base from, by its name.
        mounting: Whether it is watched that the camera stays where it is.
        web: The page on which a browser sees the run; None for none.
        recording: What the run keeps by itself; None for nothing.
        timeline: What it keeps for the page's timeline; None for what is usual.
        black_box: What it keeps in memory, and writes around what happens; None for nothing.
        place: Where it is, for schedules; None for anywhere, in the time zone of the computer.
        landmarks: The tags of known places, which tell where the camera is; None for none.
    """

    drivers: dict[KeyPath, DriverChoice] = field(default_factory=dict)
    camera_model: CameraModel | None = None
    rig: StereoRig | None = None
    button_tables: dict[str, models.ButtonTable] = field(default_factory=dict)
    sensor_tables: dict[str, models.SensorTable] = field(default_factory=dict)
    mounting: MountingTable = field(default_factory=MountingTable)
    web: models.WebTable | None = None
    recording: RecordingTable | None = None
    timeline: TimelineTable | None = None
    black_box: BlackBoxTable | None = None
    place: models.PlaceTable | None = None
    landmarks: Landmarks | None = None

    @property
    def targets(self) -> tuple[DriverChoice, ...]:
        """The detector of each target, in the order of the file."""
        return self._named("targets")

    @property
    def actuators(self) -> tuple[DriverChoice, ...]:
        """The actuators, in the order of the file; so are buttons and notifiers."""
        return self._named("actuators")

    @property
    def buttons(self) -> tuple[DriverChoice, ...]:
        """The buttons."""
        return self._named("buttons")

    @property
    def notifiers(self) -> tuple[DriverChoice, ...]:
        """The services that notify people."""
        return self._named("notifiers")

    @property
    def sensors(self) -> tuple[DriverChoice, ...]:
        """The range sensors."""
        return self._named("sensors")

    @property
    def base(self) -> DriverChoice | None:
        """The mobile base; None for none, and so are those below."""
        return self.drivers.get((BASE_NAME,))

    @property
    def messenger(self) -> DriverChoice | None:
        """The broker that events are published to."""
        return self.drivers.get(("messenger",))

    @property
    def second_camera(self) -> DriverChoice | None:
        """The camera beside the first one."""
        return self.drivers.get(("second_camera",))

    @property
    def world(self) -> DriverChoice | None:
        """The simulated world. Its robot is the one that the base describes, where the world does not say otherwise."""
        world = self.drivers.get(("world",))
        if world is None or self.base is None:
            return world
        written = world.options.model_fields_set
        robot = {name: figure for name, figure in _robot(self.base.options).items() if name not in written}
        return replace(world, options=world.options.model_copy(update=robot))

    @property
    def status_led(self) -> DriverChoice | None:
        """The light that shows how the run is doing."""
        return self.drivers.get(("status_led",))

    def _named(self, section: str) -> tuple[DriverChoice, ...]:
        return tuple(choice for at, choice in self.drivers.items() if at[0] == section)


def _robot(base: Any) -> dict[str, float]:
    """Return the figures that the options of a base give of its robot, by their names in a simulated world."""
    track_width, ticks, wheel = (
        getattr(base, name, None) for name in ("track_width", "ticks_per_turn", "wheel_diameter")
    )
    robot = {"track_width": track_width} if track_width else {}
    return robot | {"ticks_per_metre": ticks / (math.pi * wheel)} if ticks and wheel else robot


class Draft(ConfiguredParts, kw_only=True):
    """A configuration as far as it could be read.

    Attributes:
        table: The whole file as the TOML parser read it.
        file_problems: What is wrong in a camera file that it names.
        output_tables: What every actuator has, and the base, by name.
        rules: The rules that could be read, by name.
        figures: The remembered figures likewise.
        tests: The tests that could be read, by their position in the file.
        compiled: The same rules as the core runs them, each beside its table.
    """

    table: Mapping[str, Any]
    findings: list[Finding] = field(default_factory=list)
    file_problems: list[Problem] = field(default_factory=list)
    camera_table: models.CameraTable = field(default_factory=models.CameraTable)
    target_tables: dict[str, models.TargetTable] = field(default_factory=dict)
    output_tables: dict[str, models.ActuatorTable | models.BaseTable] = field(default_factory=dict)
    tracking: models.TrackingTable = field(default_factory=models.TrackingTable)
    safety: models.SafetyTable = field(default_factory=models.SafetyTable)
    rules: dict[str, RuleTable] = field(default_factory=dict)
    figures: dict[str, FigureTable] = field(default_factory=dict)
    tests: dict[int, RuleTest] = field(default_factory=dict)
    compiled: tuple[CompiledRule, ...] = ()

    def names(self, section: str) -> tuple[str, ...]:
        """Return the names that a section such as ``actuators`` declares, in order, even of what could not be read.

        Of a table of several targets these are the names of its members.
        """
        return tuple(self.tables(section)) if section != "targets" else self.expanded(self.tables(section))

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """The tables that stand for several targets of one kind, by name, and the names of their members."""
        read = {choice.name: choice for choice in self.targets}
        found = {}
        for name, table in self.tables("targets").items():
            if name in read and read[name].options.members:
                found[name] = read[name].members
            elif {"count", "ids"} & table.keys():  # it is said where it stands that this cannot be read
                found[name] = tuple(f"{name}-{number}" for number in numbered(MAX_SEVERAL))
        return found

    @property
    def implied_targets(self) -> tuple[str, ...]:
        """The targets, of which the first is meant where none is named: of several of one kind the nearest one."""
        nearest = [each.name for each in self.nearest if not each.is_farthest and len(each.members) > 1]
        return (*(nearest if len(self.tables("targets")) == 1 else ()), *self.names("targets"))

    def expanded(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return names of targets, with its members in place of each group."""
        groups = self.groups
        return tuple(member for name in names for member in groups.get(name, (name,)))

    @property
    def nearest(self) -> tuple[NearestOf, ...]:
        """The nearest and the farthest of each group, which rules may watch like any target."""
        return tuple(
            NearestOf(name=f"{name}-{word}", members=members, is_farthest=word == "farthest")
            for name, members in self.groups.items()
            for word in ("nearest", "farthest")
        )

    def target_hint(self, name: str) -> str:
        """Suggest what to write in place of a target that there is none of."""
        group = next((each for each in self.groups if name == each or name.startswith(f"{each}-")), None)
        if group is None:
            return did_you_mean_or_list(name, (*self.groups, *self.target_names))
        members = " to ".join(dict.fromkeys((self.groups[group][0], self.groups[group][-1])))
        return f"'{group}' stands for {members}: name one, or {group}-nearest or {group}-farthest"

    def tables(self, section: str) -> dict[str, Mapping[str, Any]]:
        """Return the tables of a section such as ``rules`` by name, as they were written; only what is a table."""
        tables = self.table.get(section, {})
        if not isinstance(tables, Mapping):
            return {}
        return {name: table for name, table in tables.items() if isinstance(table, Mapping)}

    @property
    def any_target_hint(self) -> str:
        """The text to add where a target must be named."""
        return f'add target = "{next((each.name for each in self.nearest), self.target_names[0])}"'

    @property
    def target_names(self) -> tuple[str, ...]:
        """The names that rules may watch: what is measured, and the nearest and farthest of several."""
        return (*self.measured_names, *(each.name for each in self.nearest))

    @property
    def measured_names(self) -> tuple[str, ...]:
        """The targets, and the range sensors, each a target of its own."""
        return (*self.names("targets"), *self.names("sensors"))

    @property
    def output_names(self) -> tuple[str, ...]:
        """The names of the actuators and of the base, even of what could not be read."""
        return (*self.names("actuators"), *([BASE_NAME] if BASE_NAME in self.table else []))

    @property
    def camera(self) -> DriverChoice | None:
        """The camera, if its driver could be read."""
        return self.drivers.get(("camera",))


def _of_nearest(value: Any, groups: Container[str]) -> Any:
    """Return a table in which a target that is a group of several is the nearest of them, which stands for any."""
    if isinstance(value, list):
        return [_of_nearest(each, groups) for each in value]
    if not isinstance(value, Mapping):
        return value
    return {
        key: f"{each}-nearest"
        if key == "target" and isinstance(each, str) and each in groups
        else _of_nearest(each, groups)
        for key, each in value.items()
    }


def output_path(name: str) -> KeyPath:
    """Return where the table of an output stands."""
    return (BASE_NAME,) if name == BASE_NAME else ("actuators", name)


def read_draft(table: Mapping[str, Any], file: Path, texts: Texts | None = None) -> Draft:
    """Read every part of a configuration but its tests.

    Args:
        table: The file as the TOML parser read it.
        file: The file; paths are relative to its folder.
        texts: What to read in place of other files.
    """
    return _Reader(table, file, texts).read()


class _Reader:
    """Fills a draft, part by part."""

    def __init__(self, table: Mapping[str, Any], file: Path, texts: Texts | None) -> None:
        self.texts = texts
        self.draft = Draft(table=table)
        self.context = {**validation_context(file), GAPS: self.draft.names("figures")}
        self.folder = file.parent

    def read(self) -> Draft:
        self._sections()
        self._drivers()
        self._settings()
        self._rules()
        return self.draft

    def _sections(self) -> None:
        for section in self.draft.table.keys() - set(models.SECTIONS):
            hint = did_you_mean_or_list(section, models.SECTIONS)
            self._found((section,), f"unknown section '{section}'", hint, "unknown-key")
        if "camera" not in self.draft.table:
            self._found(("camera",), "the section [camera] is missing", 'add one, such as driver = "opencv"')
        if not self.draft.table.get("targets"):
            self._found(("targets",), "there is no target", "add one, such as [targets.ball]")

    def _drivers(self) -> None:
        """Add every driver to the draft, and the keys that every driver of its kind has."""
        for section, kind in DRIVER_KINDS.items():
            for at, table in self._tables_of(section, is_named=kind.is_named):
                choice, common = read_driver_table(kind, at, table, self.context, self.draft.findings)
                if choice is not None:
                    self.draft.drivers[at] = choice
                self._common(at[-1], common)

    def _common(self, name: str, common: models.Section | None) -> None:
        match common:
            case models.CameraTable():
                self._camera_model(common.model)
                self.draft.camera_table = common
            case models.SecondCameraTable():
                self._stereo_file(common.stereo)
            case models.TargetTable():
                self.draft.target_tables[name] = common
            case models.ActuatorTable() | models.BaseTable():
                self.draft.output_tables[name] = common
            case models.SensorTable():
                self.draft.sensor_tables[name] = common
            case models.ButtonTable():
                self.draft.button_tables[name] = common

    def _tables_of(self, section: str, *, is_named: bool) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
        if is_named:
            yield from (((section, name), table) for name, table in self._named(section))
        elif (table := self._table(section)) is not None:
            yield (section,), table

    def _camera_model(self, value: object) -> None:
        try:
            if isinstance(value, str):
                self._camera_file(path_from(self.folder, value))
            elif isinstance(value, Mapping):
                self.draft.camera_model = camera_model_from_table(dict(value))
            elif value is not None:
                self._found(("camera", "model"), f"{format_value(value)} is neither a camera file nor a table")
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
            self._wrong_in_file(error, ("camera", "model"), f"the camera file {file}")

    def _stereo_file(self, file: Path) -> None:
        from stadimeter.config.camera_file import load_stereo_rig  # noqa: PLC0415 - most runs have one camera

        try:
            self.draft.rig = load_stereo_rig(file, self.texts)
        except ConfigError as error:
            self._wrong_in_file(error, ("second_camera", "stereo"), f"the stereo file {file}")
        else:
            self.draft.camera_model = self.draft.rig.left

    def _wrong_in_file(self, error: ConfigError, key: KeyPath, file: str) -> None:
        for problem in error.problems:
            if problem.code == UNREADABLE:
                self._found(key, f"{file}: {problem.message}", problem.hint)
            else:
                self.draft.file_problems.append(problem)

    def _settings(self) -> None:
        for name, model in OPTIONAL_TABLES.items():
            table = self._table(name)
            if table is not None and (read := self._validated(model, (name,), table)) is not None:
                setattr(self.draft, name, read)
        if (landmarks := self._table("landmarks")) is not None:
            from stadimeter.config.landmark_tables import read_landmarks  # noqa: PLC0415 - most runs have none

            found = read_landmarks(landmarks, self.context, self.draft.findings)
            if found is not None:
                self.draft.landmarks, self.draft.drivers["landmarks",] = found

    def _rules(self) -> None:
        groups = self.draft.groups
        for name, table in self._named("figures"):
            figure = self._validated(FigureTable, ("figures", name), _of_nearest(table, groups))
            if figure is not None:
                self.draft.figures[name] = figure
        for name, table in self._named("rules"):
            rule = self._validated(RuleTable, ("rules", name), _of_nearest(table, groups))
            if rule is not None and rule.targets is not None:
                rule = rule.model_copy(update={"targets": [*self.draft.expanded(rule.targets)]})
            if rule is not None:
                self.draft.rules[name] = rule
        draft = self.draft
        several = SeveralNames(draft.groups, draft.measured_names, draft.figures)
        draft.compiled = compile_rules(draft.rules, draft.tables("rules"), draft.implied_targets, several)

    def _validated(self, model: type[ModelT], at: KeyPath, table: Mapping[str, Any]) -> ModelT | None:
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
