"""The configuration, and the broker that it names."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.workbench.doctor.diagnosis import Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import INSTALLED, Examined

ELSEWHERE = frozenset({"driver-lacks", "will-not-run"})
"""The findings of ``check`` that keep a configuration from running on this computer."""


def configuration(examined: Examined) -> Iterator[Diagnosis]:
    """Tell in a line what ``check`` finds."""
    if examined.why_none is not None:
        yield examined.why_none
        return
    found = examined.configuration
    if found is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    from stadimeter.app.feasibility import feasibility_warnings  # noqa: PLC0415 - they load the drivers
    from stadimeter.app.this_computer import warnings_here  # noqa: PLC0415

    problems = (*warnings_here(found), *found.warnings, *feasibility_warnings(found))
    if not problems:
        yield fine(f"{found.path} can be used, and `check` finds nothing")
        return
    is_wrong = any(problem.code in ELSEWHERE for problem in problems)
    count = f"{len(problems)} warning{'s' * (len(problems) > 1)} of `check`, the first: {problems[0].message}"
    judged, how = (wrong, "will not work here") if is_wrong else (warning, "can be used")
    yield judged(f"{found.path} {how}; {count}", f"`stadimeter check {found.path}` shows each with what to do")


def broker(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the broker that the configuration names takes its login."""
    messenger = examined.configuration.messenger if examined.configuration else None
    if messenger is None or messenger.plugin.reach is None:
        return
    trouble = messenger.plugin.reach(messenger.options)
    if trouble:
        yield wrong(trouble, 'docs/troubleshooting.md, section "MQTT and notifications"')
    else:
        yield fine("the broker takes the connection with the configuration's login")
