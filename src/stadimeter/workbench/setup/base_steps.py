"""Questions about the robot's base: which driver, of those that are installed, and the options that it needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pydantic.fields import FieldInfo
from pydantic.json_schema import WithJsonSchema

from stadimeter.config.driver_tables import BASE
from stadimeter.config.plugins import DriverOptions, driver_names, load_driver
from stadimeter.config.schema import documented_fields
from stadimeter.config.toml_source import as_toml
from stadimeter.config.units import PortMark
from stadimeter.errors import ConfigError, DriverError
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.setup.files import SCREEN, base_table
from stadimeter.workbench.setup.question import Accepted, Known, Option, Question, SetupStep

# What most who build a robot that follows have.
USUAL = "gpio-motors"


def base_drivers() -> dict[str, type[DriverOptions] | None]:
    """Return the installed drivers of real bases that drive, by name; None for one whose library is missing."""
    found: dict[str, type[DriverOptions] | None] = {}
    for name in driver_names(BASE.group):
        try:
            model = load_driver(BASE.group, name)
        except DriverError:
            found[name] = None
        else:
            if not model.needs_world and not model.only_turns:
                found[name] = model
    return found


class BaseStep(SetupStep):
    """The question of what moves the robot."""

    key = "base"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """List the bases that have a driver, and the screen."""
        options = [
            Option(name, model.title if model else "its library is not installed")
            for name, model in base_drivers().items()
        ]
        return Question(
            text="What is the robot's base?",
            options=(*options, Option(SCREEN, "no robot yet; the live view shows what it would do")),
            ready=USUAL if Computer().is_pi else SCREEN,
        )

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Check that there is such a driver."""
        names = base_drivers()
        if text != SCREEN and text not in names:
            raise ConfigError(f"{text!r} is none of {', '.join(names)} and {SCREEN}")
        if text != SCREEN:
            load_driver(BASE.group, text)
        return Accepted(answer=text)


def option_steps(driver: str) -> Iterator[BaseOptionStep]:
    """Yield a question for each option of a base that it needs, or has an example for."""
    model = base_drivers().get(driver)
    for name, field in (model.model_fields if model else {}).items():
        if model and (field.is_required() or field.examples):
            yield BaseOptionStep(model, name)


@dataclass
class BaseOptionStep(SetupStep):
    """An option of a base."""

    model: type[DriverOptions]
    option: str
    kind = "blank"

    def __post_init__(self) -> None:
        self.key = f"base_{self.option}"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Ask what the option's description says; a port is one of those that there are."""
        field = self.model.model_fields[self.option]
        found = _ports() if any(isinstance(mark, PortMark) for mark in field.metadata) else []
        example = found[0] if found else _example(field)
        words = dict(documented_fields(self.model)).get(self.option, "")
        return Question(
            text=f"{self.option}: {words}",
            options=tuple(Option(port, "a serial port of this computer") for port in found),
            ready=example,
            form=f"such as {example}" if example else "",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the option; the last one together with the others."""
        answers = {**known.answers, self.key: text}
        is_last = all(step.key in answers for step in option_steps(answers["base"]))
        known.check(BASE, ("base",), base_table(answers), None if is_last else [self.option])
        return Accepted(answer=text)


def _ports() -> list[str]:
    return sorted(map(str, Path("/dev/serial/by-id").glob("*")))


def _example(field: FieldInfo) -> str:
    """Return an example as a person would write it: the option's own, else that of its type; empty for none."""
    of_type = [
        example
        for mark in field.metadata
        if isinstance(mark, WithJsonSchema)
        for example in (mark.json_schema or {}).get("examples", ())
    ]
    if any(isinstance(mark, PortMark) for mark in field.metadata):
        of_type = ["/dev/ttyUSB0"]
    for example in (*(field.examples or ()), *of_type):
        return example if isinstance(example, str) and example.isprintable() else as_toml(example)
    return ""
