"""The facts that the checks ask of a configuration. Loading this loads numpy, pydantic and the drivers."""

from __future__ import annotations

from pathlib import Path

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.service import safe_lines
from stadimeter.app.this_computer import warnings_here
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import marked_options
from stadimeter.config.units import PortMark
from stadimeter.workbench.doctor.computer import Configured
from stadimeter.workbench.wiring import find_outputs, parts_of


def read_configured(path: Path) -> Configured:
    """Read a configuration; raises `StadimeterError` if it cannot be used."""
    found = load_configuration(path)
    ports = marked_options(found.base.options, PortMark) if found.base is not None else ()
    return Configured(
        configuration=found,
        pins=frozenset(output.gpio for output in find_outputs(parts_of(found))),
        ports=tuple(str(port) for _key, port in ports if str(port).startswith("/")),
        is_scheduled=found.plan.needs_wall_time,
        safe_lines=tuple(line for each in found.driven if not each.is_simulated for line in safe_lines(each)),
        find_warnings=lambda: (*warnings_here(found), *found.warnings, *feasibility_warnings(found)),
    )
