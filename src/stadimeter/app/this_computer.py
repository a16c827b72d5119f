"""What would keep a configuration from running on this computer, though it may be right on another one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from stadimeter.app.bootstrap import build
from stadimeter.config.findings import Finding, problems
from stadimeter.config.loader import Configuration
from stadimeter.config.toml_lines import KeyPath
from stadimeter.errors import ConfigError, DriverUnavailableError, Problem, StadimeterError


def warnings_here(configuration: Configuration) -> tuple[Problem, ...]:
    """Find what a run would lack here: devices, files, libraries, permissions. No hardware is touched."""
    lacking = problems(_lacking(configuration), str(configuration.path), configuration.spans)
    return (*lacking, *_why_not_built(configuration))


def _lacking(configuration: Configuration) -> Iterator[Finding]:
    lacking: dict[str, list[KeyPath]] = defaultdict(list)
    for at, part in configuration.parts():
        for lack in part.plugin.lacks(part.options):
            lacking[lack].append(at)
    for lack, parts in lacking.items():  # what several parts lack is said once
        names = " and ".join(f"'{at[-1]}'" for at in parts)
        hint = "if it runs on another computer, add --elsewhere"
        yield Finding(parts[0], f"{names} will not work here: {lack}", hint, "driver-lacks")


def _why_not_built(configuration: Configuration) -> tuple[Problem, ...]:
    """Return why a run would not begin. A library that is missing is left out: its driver has said so."""
    try:
        build(configuration)
    except ConfigError as error:
        return tuple(error.problems)
    except DriverUnavailableError:
        return ()
    except StadimeterError as error:
        words = f"`stadimeter run` refuses this: {error}"
        return (Problem(words, file=str(configuration.path), code="will-not-run"),)
    return ()
