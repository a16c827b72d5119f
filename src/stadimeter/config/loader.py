"""Loads a configuration, or raises one error that lists everything that is wrong with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from stadimeter.config.cross_checks import error_findings, warning_findings
from stadimeter.config.draft import BASE_NAME, Draft, read_draft
from stadimeter.config.driver_choice import DriverChoice
from stadimeter.config.driver_tables import CAMERA, read_driver_table
from stadimeter.config.driver_warnings import driver_warnings
from stadimeter.config.findings import Finding, problems
from stadimeter.config.models import ActuatorTable, BaseTable
from stadimeter.config.paths import validation_context
from stadimeter.config.rule_tests.checks import rule_test_findings, rule_test_warnings
from stadimeter.config.rule_tests.tables import RuleTest, name_of
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.secrets import secret_warnings, without_secrets
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.toml_source import read_toml
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.plan import Output, Plan
from stadimeter.errors import ConfigError, Problem

__all__ = ["Configuration", "DriverChoice", "load_camera_choice", "load_configuration"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """A configuration without errors.

    Attributes:
        text: What stood in it, without secrets: it is recorded.
        plan: What it declares, as the core sees it.
        rules: The rules of the plan, in its order, each beside its table in the file.
        spans: Where each key stands in the file.
        camera_model: The lens, or None if it names none; then it has no rules.
        targets: The detector of each target, in the order of the file.
        actuators: The driver of each actuator, in the order of the file.
        base: The base's driver, or None.
        messenger: The messenger's driver, or None.
        notifiers: The driver of each notifier, in the order of the file.
        world: The simulated world, or None.
        leases_s: For each output how old the frame behind a command may grow, in seconds.
        stays_off: The outputs that stay off for the rest of a run once their driver failed.
        warnings: What is allowed and hardly meant.
        tests: The tests of its rules, in the order of the file.
    """

    path: Path
    text: str
    plan: Plan
    rules: tuple[CompiledRule, ...]
    spans: Mapping[KeyPath, SourceSpan]
    camera: DriverChoice
    camera_model: CameraModel | None
    targets: tuple[DriverChoice, ...]
    actuators: tuple[DriverChoice, ...]
    base: DriverChoice | None
    messenger: DriverChoice | None
    world: DriverChoice | None
    leases_s: Mapping[str, float]
    stays_off: frozenset[str]
    warnings: tuple[Problem, ...]
    tests: tuple[RuleTest, ...] = ()
    notifiers: tuple[DriverChoice, ...] = ()


def load_configuration(path: Path) -> Configuration:
    """Load a configuration and the camera file that it names.

    Raises:
        ConfigError: It lists every problem, in the order of the file.
    """
    source = read_toml(path, CONFIGURATION_MAX_BYTES)
    draft, spans = read_draft(source.table, path), source.spans
    text_to_show, not_hidden = without_secrets(draft, source.text, spans)
    findings = [*draft.findings, *error_findings(draft), *rule_test_findings(draft), *not_hidden]
    found = [*problems(findings, str(path), spans), *draft.file_problems]
    if found or draft.camera is None:
        raise ConfigError(found, problems(_warnings_elsewhere(draft, findings), str(path), spans))
    return Configuration(
        path=path,
        text=text_to_show,
        plan=_plan(draft),
        rules=draft.compiled,
        spans=spans,
        camera=draft.camera,
        camera_model=draft.camera_model,
        targets=tuple(draft.targets),
        actuators=tuple(draft.actuators),
        base=draft.base,
        messenger=draft.messenger,
        notifiers=tuple(draft.notifiers),
        world=draft.world,
        leases_s={name: table.lease for name, table in _output_tables(draft).items()},
        stays_off=frozenset(name for name, table in _output_tables(draft).items() if table.after_fault == "stay_off"),
        warnings=problems(
            (*warning_findings(draft), *rule_test_warnings(draft), *secret_warnings(draft), *driver_warnings(draft)),
            str(path),
            spans,
        ),
        tests=_tests(draft, spans),
    )


def load_camera_choice(path: Path) -> DriverChoice:
    """Load the camera of a configuration, and nothing else: not its camera file, which may not be there yet.

    Raises:
        ConfigError: It lists every problem of the section ``[camera]``.
    """
    source = read_toml(path, CONFIGURATION_MAX_BYTES)
    table = source.table.get("camera")
    if not isinstance(table, Mapping):
        finding = Finding(("camera",), "the section [camera] is missing", 'add one: driver = "opencv"', "missing-key")
        raise ConfigError(problems([finding], str(path), source.spans))
    read = read_driver_table(CAMERA, ("camera",), table, validation_context(path))
    if read.choice is None or read.findings:
        raise ConfigError(problems(read.findings, str(path), source.spans))
    return read.choice


def _plan(draft: Draft) -> Plan:
    outputs: list[Output] = [table.to_plan(name) for name, table in draft.actuator_tables.items()]
    if draft.base_table is not None:
        outputs.append(draft.base_table.to_plan(BASE_NAME))
    return Plan(
        targets=draft.names("targets"),
        rules=tuple(each.rule for each in draft.compiled),
        outputs=tuple(outputs),
        tracking=draft.tracking.to_plan(),
        safety=draft.safety.to_plan(),
    )


def _warnings_elsewhere(draft: Draft, errors: Iterable[Finding]) -> Iterator[Finding]:
    """Go through the warnings about rules that have no error themselves."""
    wrong = {finding.path[:2] for finding in errors}
    if ("rules",) not in wrong:
        yield from (each for each in warning_findings(draft) if each.path[0] == "rules" and each.path[:2] not in wrong)


def _tests(draft: Draft, spans: Mapping[KeyPath, SourceSpan]) -> tuple[RuleTest, ...]:
    return tuple(
        RuleTest(
            name=name_of(table, position),
            line=spans["tests", position].line,
            input=table.input,
            expect=table.expect,
        )
        for position, table in draft.tests.items()
    )


def _output_tables(draft: Draft) -> dict[str, ActuatorTable | BaseTable]:
    base = {BASE_NAME: draft.base_table} if draft.base_table is not None else {}
    return {**draft.actuator_tables, **base}
