"""Loads a configuration, or raises one error that lists everything that is wrong with it.

Source with spans (`toml_source`) → models (`draft`) → compiled rules (`rules.compiled`) → checks (`checks`) →
`Configuration`. Each step is done once; what needs a result takes it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import field
from msgspec.structs import replace

import stadimeter
from stadimeter.config.checks import error_findings
from stadimeter.config.draft import BASE_NAME, ConfiguredParts, Draft, read_draft
from stadimeter.config.driver_tables import CAMERA, MESSENGER, DriverKind, read_driver_table
from stadimeter.config.files import CONFIGURATION_MAX_BYTES
from stadimeter.config.findings import Finding, problems
from stadimeter.config.models import ActuatorTable, BaseTable
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.secrets import without_secrets
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.toml_source import Texts, TomlSource, read_toml
from stadimeter.config.units import validation_context
from stadimeter.core.camera_pose import Footing, Mount
from stadimeter.core.plan import Output, Plan
from stadimeter.errors import ConfigError, Problem

if TYPE_CHECKING:  # loaded only for configurations whose tests are asked for
    from stadimeter.config.rule_test_tables import RuleTest

__all__ = ["Configuration", "DriverChoice", "is_demonstration", "load_camera_choice", "load_configuration"]

# The configuration of the demonstration: ``config/demo.toml`` of the checkout, or its copy in a package.
DEMONSTRATION = Path(stadimeter.__file__).parent / "configurations" / "demo.toml"


def is_demonstration(configuration: Path) -> bool:
    """Check whether a file is the demonstration's, which nothing may change and beside which nothing is written."""
    return configuration.resolve() == DEMONSTRATION.resolve()


class Configuration(ConfiguredParts, frozen=True, kw_only=True, eq=False):  # type: ignore[misc]  # msgspec allows it
    """A configuration without errors.

    Attributes:
        text: What stood in the file, without secrets: it is recorded.
        plan: What it declares, as the core sees it.
        rules: The rules of the plan, in its order, each beside its table in the file.
        spans: Where each key stands in the file.
        leases_s: For each output how old the frame behind a command may grow, in seconds.
        stays_off: The outputs that stay off for the rest of a run once their driver failed.
        footings: What is known of each target that is on the floor, by its name.
        mount: Where the camera sits on a robot; None for on none.
        tilt_sigma_rad: How well the camera's tilt is known; None where that is not said.
        find_warnings: Finds what is hardly meant, too.
        tests: The tests of its rules; none if they were not asked for.
    """

    path: Path
    text: str
    plan: Plan
    rules: tuple[CompiledRule, ...]
    spans: Mapping[KeyPath, SourceSpan]
    leases_s: Mapping[str, float]
    stays_off: frozenset[str]
    find_warnings: Callable[[], tuple[Problem, ...]]
    tests: tuple[RuleTest, ...] = ()
    footings: Mapping[str, Footing] = field(default_factory=dict)
    mount: Mount | None = None
    tilt_sigma_rad: float | None = None

    @property
    def camera(self) -> DriverChoice:
        """The camera."""
        return self.drivers["camera",]

    @property
    def driven(self) -> tuple[DriverChoice, ...]:
        """The drivers that must be off when no program runs: the actuators, the base, and the status LED."""
        return (*self.actuators, *(each for each in (self.base, self.status_led) if each is not None))

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Things allowed and hardly meant. They are looked for when first asked for: a run starts without them."""
        return self.find_warnings()


def load_configuration(path: Path, *, with_tests: bool = True, texts: Texts | None = None) -> Configuration:
    """Load a configuration and the camera file that it names.

    Args:
        path: The TOML file.
        with_tests: Whether to read the tests of its rules. A run needs none, and one that is wrong does not stop it.
        texts: What to read in place of the file, or of its camera file, as if it stood there.

    Raises:
        ConfigError: It lists every problem, in the order of the file.
    """
    source = read_toml(path, CONFIGURATION_MAX_BYTES, texts=texts)
    if "fx_px" in source.table and "targets" not in source.table:
        hint = f'name it in a configuration, as model = "{path.name}" in its [camera]'
        raise ConfigError([Problem("this is a camera file, not a configuration", str(path), hint=hint)])
    draft = read_draft(source.table, path, texts)
    if with_tests and source.table.get("tests"):
        from stadimeter.config.warnings import read_tests  # noqa: PLC0415 - most runs have no tests

        read_tests(draft, path, source.spans)
    text, not_hidden = without_secrets(draft, source.text, source.spans)
    findings = [*draft.findings, *error_findings(draft), *not_hidden]
    found = [*problems(findings, str(path), source.spans), *draft.file_problems]
    if found or draft.camera is None:
        raise ConfigError(found)
    parts: dict[str, Any] = {name: getattr(draft, name) for name in ConfiguredParts.__struct_fields__}
    return Configuration(
        **parts,
        path=path,
        text=text,
        plan=_plan(draft),
        rules=draft.compiled,
        spans=source.spans,
        footings=_footings(draft),
        mount=draft.camera_table.on_robot(),
        tilt_sigma_rad=draft.camera_table.tilt.sigma,
        leases_s={name: table.lease for name, table in draft.output_tables.items()},
        stays_off=frozenset(name for name, table in draft.output_tables.items() if table.after_fault == "stay_off"),
        find_warnings=cache(lambda: _warnings(draft, path, source)),
        tests=tuple(draft.tests.values()),
    )


def load_camera_choice(path: Path) -> DriverChoice:
    """Load the camera of a configuration, and nothing else: not its camera file, which may not be there yet.

    Raises:
        ConfigError: It lists every problem of the section ``[camera]``.
    """
    return _load_choice(path, "camera", CAMERA, 'add one: driver = "opencv"')


def load_messenger_choice(path: Path) -> DriverChoice:
    """Load the messenger of a configuration, and nothing else.

    Raises:
        ConfigError: It lists every problem of the section ``[messenger]``.
    """
    return _load_choice(path, "messenger", MESSENGER, 'add one: driver = "mqtt"')


def _load_choice(path: Path, section: str, kind: DriverKind, remedy: str) -> DriverChoice:
    source = read_toml(path, CONFIGURATION_MAX_BYTES)
    table = source.table.get(section)
    if not isinstance(table, Mapping):
        finding = Finding((section,), f"the section [{section}] is missing", remedy, "missing-key")
        raise ConfigError(problems([finding], str(path), source.spans))
    findings: list[Finding] = []
    choice, _ = read_driver_table(kind, (section,), table, validation_context(path), findings)
    if choice is None or findings:
        raise ConfigError(problems(findings, str(path), source.spans))
    return choice


def _plan(draft: Draft) -> Plan:
    return Plan(
        targets=draft.target_names,
        nearest=draft.nearest,
        rules=tuple(each.rule for each in draft.compiled),
        outputs=tuple(_output(draft, name, table) for name, table in draft.output_tables.items()),
        tracking=draft.tracking.to_plan(),
        safety=draft.safety.to_plan(),
        sensor_pairs=tuple(table.to_plan(name) for name, table in draft.sensor_tables.items() if table.confirms),
        viewpoint=draft.camera_table.to_plan(draft.camera_model),
        figures=tuple(table.to_plan(name, draft.implied_targets) for name, table in draft.figures.items()),
    )


def _footings(draft: Draft) -> dict[str, Footing]:
    every = {name: draft.camera_table.footing(table) for name, table in draft.target_tables.items()}
    return {name: footing for name, footing in every.items() if footing is not None}


def _output(draft: Draft, name: str, table: ActuatorTable | BaseTable) -> Output:
    """Return an output as the core sees it. Of a base, the driver knows how far apart wheels are, and if it tilts."""
    if not isinstance(table, BaseTable):
        return table.to_plan(name)
    driver = draft.drivers.get((BASE_NAME,))
    options = driver.options if driver is not None else None
    tilts = getattr(options, "tilt", None) is not None
    return replace(table.to_plan(name), track_width_m=getattr(options, "track_width", None), tilts=tilts)


def _warnings(draft: Draft, path: Path, source: TomlSource) -> tuple[Problem, ...]:
    """List what deserves a look."""
    from stadimeter.config.warnings import warning_findings  # noqa: PLC0415 - no run needs it to start

    return problems(warning_findings(draft), str(path), source.spans)
