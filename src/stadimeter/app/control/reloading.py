"""Applying a changed configuration to a run: while it goes on, by a reload; or by a restart.

The file is read and checked apart from the control loop. If it is sound, and asks for nothing that only a restart can
change, the loop applies it between two cycles. Else nothing changes at all, and the answer says why: a run
always goes by one file, and never by half of one and half of another.

Before a restart, everything that the file names is built. Only if that succeeds, the run ends as at SIGTERM, its
outputs first, and the program begins again with the same command line. It keeps its process id, so that systemd, and
the shell that started it, see one process all the time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from msgspec import Struct

from stadimeter.app.control.messages import NoArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.recordings.journal import RecordedConfiguration, to_be_recorded
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.rules.scheduler import new_rules
from stadimeter.errors import StadimeterError

# What a reload can change or is compared by its parts (plan, drivers), and the page's table. All else needs a restart:
# only a start builds the parts of a run of it.
_LIVE = frozenset({"path", "text", "plan", "rules", "spans", "tests", "drivers", "find_warnings", "web"})
_LIVE_OF_PLAN = frozenset({"rules", "tracking", "safety", "viewpoint", "figures", "nearest"})
_LIVE_OF_SAFETY = frozenset({"max_frame_age_s", "good_frames", "arm", "watchdog_s"})

ResultT = TypeVar("ResultT")

_SECTIONS = {
    "camera_model": "camera.model",
    "rig": "second_camera.stereo",
    "leases_s": "lease of an output",
    "stays_off": "after_fault",
    "button_tables": "buttons",
    "sensor_tables": "sensors",
    "tilt_sigma_rad": "camera.tilt",
    "outputs": "actuators or base",
    "sensor_pairs": "sensors",
    "liveness": "safety.liveness",
    "viewpoint": "camera",
}


class CheckedConfiguration(Struct, frozen=True, kw_only=True):
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
        found = _result_or_error(lambda: self._change(answer), "nothing was changed")
        if isinstance(found, Reply):
            self.done()
            answer(found)
        else:
            self._ready = found

    def _change(self, answer: Answer) -> CheckedConfiguration | Reply:
        from stadimeter.app.feasibility import feasibility_warnings  # noqa: PLC0415 - no run needs it to start

        configuration = load_configuration(self.running.path)
        asked = needs_restart(self.running, configuration)
        if asked:
            return Reply(error=f"nothing was changed: restart to change {', '.join(asked)}")
        new_rules(configuration.plan)  # what a plan may not be comes out here, and not in the loop
        found = (*configuration.warnings, *feasibility_warnings(configuration))
        return CheckedConfiguration(
            configuration=configuration,
            recorded=to_be_recorded(configuration),
            warnings=tuple(map(str, found)),
            answer=answer,
        )


class Restarter:
    """Checks the configuration again when asked, and then lets the run end.

    Args:
        build: Reads and checks the file, and builds what the run would begin anew with.
    """

    def __init__(self, build: Callable[[], object]) -> None:
        self._build = build
        self._is_checked = False
        self._is_cancelled = False
        self._lock = threading.Lock()

    @property
    def is_due(self) -> bool:
        """True if the run shall end now, and the program begin anew."""
        return self._is_checked and not self._is_cancelled

    def cancel(self) -> None:
        """Let the run end for good, also if the file is still being checked. May be called from a signal handler."""
        self._is_cancelled = True

    def act(self, _args: NoArgs, answer: Answer) -> None:
        """Have the file checked. Returns at once; ``answer`` may be called from another thread."""
        if not self._lock.acquire(blocking=False):
            answer(Reply(error="a restart is under way already"))
            return
        threading.Thread(target=self._try, args=(answer,), name="restart", daemon=True).start()

    def _try(self, answer: Answer) -> None:
        found = _result_or_error(self._build, "not restarted, since the run could not begin")
        if isinstance(found, Reply):
            self._lock.release()
            answer(found)
        else:
            answer(Reply({"words": "restarting"}))
            self._is_checked = True


def build_parts(configuration: Path) -> object:
    """Build all parts of a run, and open none of them; errors as at the start of a run."""
    from stadimeter.app.bootstrap import build  # noqa: PLC0415 - loaded already, where this is called

    return build(load_configuration(configuration, with_tests=False))


def _result_or_error(check: Callable[[], ResultT], refusal: str) -> ResultT | Reply:
    """Return the result of a check, or the answer that says why it failed."""
    try:
        return check()
    except StadimeterError as error:
        return Reply(error=f"{refusal}:\n{error}", problems=getattr(error, "problems", ()))
    except BaseException as error:  # noqa: BLE001 - a defect in a check must not leave the one who asks waiting
        return Reply(error=f"{refusal}: the file could not be checked: {type(error).__name__}: {error}")


def needs_restart(running: Configuration, new: Configuration) -> tuple[str, ...]:
    """Return the sections, such as ``[camera]``, in which a change cannot be applied by a reload; empty if all can."""
    paths = {**running.drivers, **new.drivers}
    found = [str(at[0]) for at in paths if running.drivers.get(at) != new.drivers.get(at)]
    found += _changed(running, new, _LIVE)
    # Tags of known places are looked for from the viewpoint that the start knew.
    found += _changed(running.plan, new.plan, _LIVE_OF_PLAN - ({"viewpoint"} if new.landmarks else set()))
    found += _changed(running.plan.safety, new.plan.safety, _LIVE_OF_SAFETY)
    return tuple(dict.fromkeys(f"[{_SECTIONS.get(name, name)}]" for name in found))


def _changed(running: Struct, new: Struct, live: frozenset[str]) -> list[str]:
    """Return the names of the fields in which two differ, without those that a reload can change."""
    names = [name for name in running.__struct_fields__ if name not in live]
    return [name for name in names if not getattr(running, name) == getattr(new, name)]  # noqa: SIM201 - of structs
