"""Reloading: applying a changed configuration while a run goes on.

The file is read and checked apart from the control loop. If it is sound, and asks for nothing that only a restart can
change, the loop applies it between two cycles. Else nothing changes at all, and the answer says why: a run
always goes by one file, and never by half of one and half of another.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, fields

from stadimeter.app.control.messages import Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration, to_be_recorded
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.rules.scheduler import new_rules
from stadimeter.errors import StadimeterError

# What a reload can change, and what is compared by its parts: plan and drivers. Everything else needs a restart.
_LIVE = frozenset({"path", "text", "plan", "tests", "drivers"})

_SECTIONS = {
    "camera_model": "camera.model",
    "leases_s": "lease of an output",
    "stays_off": "after_fault",
    "button_tables": "buttons",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedConfiguration:
    """A configuration that is sound, to be applied between two cycles.

    Attributes:
        recorded: What a recording keeps of it.
        warnings: What is allowed in it and hardly meant, a line each.
        answer: Answers the request with what came of it.
    """

    configuration: Configuration
    recorded: RecordedConfiguration
    warnings: tuple[str, ...]
    answer: Answer


class Reloader:
    """Reads and checks the configuration again when asked."""

    def __init__(self, configuration: Configuration) -> None:
        self.running = configuration
        self._lock = threading.Lock()
        self._is_busy = False
        self._ready: CheckedConfiguration | None = None

    def ask(self, answer: Answer) -> None:
        """Have the file read and checked. Returns at once; ``answer`` may be called from another thread."""
        with self._lock:
            is_busy, self._is_busy = self._is_busy, True
        if is_busy:
            answer(Reply(error="the configuration is being read already"))
            return
        threading.Thread(target=self._check, args=(answer,), name="reload", daemon=True).start()

    def take(self) -> CheckedConfiguration | None:
        """Return the configuration that is ready to be applied, once; None if there is none. Never waits."""
        if self._ready is None:
            return None
        change, self._ready = self._ready, None
        return change

    def done(self, configuration: Configuration | None = None) -> None:
        """Note that a change was applied, or refused (None)."""
        self.running = configuration or self.running
        self._is_busy = False

    def _check(self, answer: Answer) -> None:
        try:
            self._ready = self._change(answer)
        except StadimeterError as error:
            self.done()
            answer(Reply(error=f"nothing was changed:\n{error}"))
        except BaseException as error:  # noqa: BLE001 - a defect in a check must not leave the one who asks waiting
            self.done()
            answer(Reply(error=f"nothing was changed: the file could not be checked: {type(error).__name__}: {error}"))

    def _change(self, answer: Answer) -> CheckedConfiguration | None:
        from stadimeter.app.feasibility import feasibility_warnings  # noqa: PLC0415 - no run needs it to start

        configuration = load_configuration(self.running.path)
        asked = needs_restart(self.running, configuration)
        if asked:
            self.done()
            answer(Reply(error=f"nothing was changed: restart to change {', '.join(asked)}"))
            return None
        new_rules(configuration.plan)  # what a plan may not be comes out here, and not in the loop
        found = (*configuration.warnings, *feasibility_warnings(configuration))
        return CheckedConfiguration(
            configuration=configuration,
            recorded=to_be_recorded(configuration),
            warnings=tuple(map(str, found)),
            answer=answer,
        )


def needs_restart(running: Configuration, new: Configuration) -> tuple[str, ...]:
    """Return the sections, such as ``[camera]``, in which a change cannot be applied by a reload; empty if all can."""
    paths = {**running.drivers, **new.drivers}
    found = [str(at[0]) for at in paths if running.drivers.get(at) != new.drivers.get(at)]
    names = [field.name for field in fields(Configuration) if field.compare and field.name not in _LIVE]
    found += [name for name in names if getattr(running, name) != getattr(new, name)]
    if running.plan.targets != new.plan.targets:
        found.append("targets")
    if running.plan.outputs != new.plan.outputs:
        found.append("actuators or base")
    return tuple(dict.fromkeys(f"[{_SECTIONS.get(name, name)}]" for name in found))
