"""The configuration, and the broker that it names."""

from __future__ import annotations

import json
from collections.abc import Iterator

from stadimeter.config.extras import PACKAGED
from stadimeter.config.guides import guide
from stadimeter.workbench.doctor.computer import Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import INSTALLED, Examined

ELSEWHERE = frozenset({"driver-lacks", "will-not-run"})
"""The findings of ``check`` that keep a configuration from running on this computer."""

PROGRAM = f"{PACKAGED}/bin/stadimeter"
"""What the service runs; ``check`` of it goes on as the service's user."""
CHECK_S = 30.0


def configuration(examined: Examined) -> Iterator[Diagnosis]:
    """Tell in a line what ``check`` finds."""
    if examined.why_none is not None:
        yield examined.why_none
        return
    found = examined.configuration
    if found is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    if examined.computer.is_root and examined.is_of_service and examined.computer.has(PROGRAM):
        yield _as_the_service(examined)
        return
    from stadimeter.app.feasibility import feasibility_warnings  # noqa: PLC0415 - they load the drivers
    from stadimeter.app.this_computer import warnings_here  # noqa: PLC0415

    problems = (*warnings_here(found), *found.warnings, *feasibility_warnings(found))
    yield _judged(str(found.path), [(each.message, each.code) for each in problems])


def _judged(path: str, problems: list[tuple[str, str]], who: str = "") -> Diagnosis:
    """Judge what `check` found: the message and the code of each."""
    if not problems:
        return fine(f"{path} can be used{who}, and `check` finds nothing")
    more = f"; and {len(problems) - 1} more" if len(problems) > 1 else ""
    judged = wrong if any(code in ELSEWHERE for _, code in problems) else warning
    return judged(f"{path}: {problems[0][0]}{more}", f"`{'sudo ' if who else ''}stadimeter check {path}` shows all")


def _as_the_service(examined: Examined) -> Diagnosis:
    """Judge what the service's user may read and open; to root, who asks, everything is open."""
    answer = examined.computer.run((PROGRAM, "check", "--json", INSTALLED), CHECK_S)
    try:
        said = json.loads(answer.output if answer else "")
        problems, warnings = said["problems"], [(each["message"], each["code"]) for each in said["warnings"]]
    except (ValueError, KeyError):
        return unknown(f"whether the service can use {INSTALLED}", f"`sudo stadimeter check {INSTALLED}` says why")
    if problems:
        more = f", and {len(problems) - 1} more" if len(problems) > 1 else ""
        seen = f"the service cannot use {INSTALLED}: {' '.join(problems[0]['message'].split())}{more}"
        return wrong(seen, f"`sudo stadimeter check {INSTALLED}` shows all")
    return _judged(INSTALLED, warnings, " by the service")


def broker(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the broker that the configuration names takes its login."""
    messenger = examined.configuration.messenger if examined.configuration else None
    if messenger is None or messenger.plugin.reach is None:
        return
    trouble = messenger.plugin.reach(messenger.options)
    if trouble:
        yield wrong(trouble, f'{guide("troubleshooting.md")}, section "MQTT and notifications"')
    else:
        yield fine("the broker takes the connection with the configuration's login")
