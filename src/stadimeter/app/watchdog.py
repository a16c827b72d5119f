"""The run's end of the watchdog process: starts it, reports at the end of each cycle on how old data outputs act.

Only a cycle renews what the watchdog process knows. That every output is at its safe value, it also learns from
whatever put them there: a lease that ran out, a signal, a fault. So a loop that is slow, or hangs, costs a run its
outputs and not its life, as long as the guard can run; a process that is stopped or hangs as a whole is killed.

Several threads report, and a signal handler may within any of them. So a report takes its number first, then looks at
the outputs, and is written last: of two reports the one with the higher number has seen the newer state, in whatever
order they arrive, and the watchdog process passes over the other one.

When the watchdog process is gone, nothing would make outputs safe if we died. Then every output is stopped until a
person releases them; see `core.safety`. A release starts a new watchdog process first.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from itertools import count

from stadimeter import watchdog
from stadimeter.app.guard import LeasedOutput, make_all_safe
from stadimeter.config.loader import Configuration
from stadimeter.errors import DriverError
from stadimeter.operator_actions import AnyCommand, OperatorAction, OperatorCommand

# Without a limit in the configuration, a process that hangs is killed this long after the longest lease: the guard,
# which wakes every 20 ms, has ended every command long before that if it can run at all.
GRACE_S = 0.7

# A watchdog process that answers nothing for this long hangs, or was stopped. A busy computer may keep it waiting.
ANSWERS_WITHIN_S = 2.0

# It needs 10 ms to start on a PC, and half a second on a small Pi whose memory card is busy.
STARTS_WITHIN_S = 10.0
ENDS_WITHIN_S = 0.5

PROGRAM = f"{watchdog.__path__[0]}/__main__.py"


def limit_s(configuration: Configuration) -> float:
    """Return the age that the data may reach on which an output acts, before the process is killed."""
    return configuration.plan.safety.watchdog_s or max(configuration.leases_s.values(), default=0.0) + GRACE_S


class WatchdogLink:
    """The watchdog process of a run, and what it hears.

    Args:
        lines: What makes every output safe.
        now_s: The time on the clock that frames are stamped with; None if that is not the computer's.
        tell: Takes a line for people.
    """

    def __init__(
        self,
        lines: Iterable[str],
        outputs: Sequence[LeasedOutput],
        limit_s: float,
        now_s: Callable[[], float] | None,
        tell: Callable[[str], None],
    ) -> None:
        self.lost = ""
        self._plan = "".join(f"{line}\n" for line in lines)
        self._outputs = outputs
        self._limit_s = limit_s
        self._now_s = now_s
        self._tell = tell
        self._process: subprocess.Popen[bytes] | None = None
        self._is_acting = self._is_reported = self._is_closed = False
        self._stops = 0
        self._numbers = count(1)
        self._asked = self._answered = 0
        self._heard_s = 0.0
        for output in outputs:
            output.at_rest = self.note_rest

    @property
    def pid(self) -> int | None:
        """The process id of the watchdog process; None before the start."""
        return self._process.pid if self._process is not None else None

    def start(self) -> None:
        """Start the process and hand it the plan; `DriverError` if it does not answer."""
        # It inherits that every signal is blocked: what ends a run must not end the one that cleans up after it.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            process = subprocess.Popen(  # noqa: S603 - our own file
                [sys.executable, "-I", "-S", PROGRAM, "hold", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                cwd="/",
                start_new_session=True,
            )
        except OSError as error:
            raise DriverError(f"the watchdog process cannot be started: {error.strerror}") from error
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._process, self._asked, self._answered, self._is_acting = process, 0, 0, False
        assert process.stdin  # noqa: S101 - for the type checker
        os.set_blocking(process.stdin.fileno(), False)
        self._write(f"{self._plan}limit {self._limit_s}\n")
        if not self._is_ready(process):
            _end(process)
            assert process.stdout  # noqa: S101
            process.stdout.close()
            raise DriverError("the watchdog process does not answer, so nothing would make outputs safe if this died")
        threading.Thread(target=self._listen, args=(process,), name="watchdog", daemon=True).start()

    def with_stop(self, commands: tuple[AnyCommand, ...]) -> tuple[AnyCommand, ...]:
        """Return the commands of a cycle, with a stop if the process is gone; a release starts a new one first."""
        if self.lost and self._is_reported and any(map(_is_release, commands)):
            self._start_again()
        if not self.lost or self._is_reported:
            return commands
        self._is_reported = True
        self._stops += 1
        stop = OperatorCommand(
            id=f"watchdog-{self._stops}", action=OperatorAction.STOP_OUTPUTS, by="the watchdog", why=self.lost
        )
        return (*commands, stop)

    def reloaded(self, configuration: Configuration) -> None:
        """Apply the limit of a configuration that was reloaded. Its outputs are the same."""
        self._limit_s = limit_s(configuration)
        self._write(f"limit {self._limit_s}\n")

    def note_cycle(self) -> None:
        """Tell the process, at the end of a cycle, on how old data the outputs act."""
        number = next(self._numbers)
        acting = self._acting_since()
        if not acting:
            if self._is_acting:
                self._write(f"rests {number}\n")
            self._is_acting = False
            return
        now_s = time.monotonic()
        if self._answered >= self._asked:
            self._heard_s = now_s
        elif now_s - self._heard_s > ANSWERS_WITHIN_S:
            self._lose(f"the watchdog process has not answered for {ANSWERS_WITHIN_S:g} s")
        age_s = max(0.0, self._now_s() - min(acting)) if self._now_s is not None else 0.0
        self._is_acting = True
        self._asked += 1
        self._write(f"acts {number} {now_s} {age_s}\n")

    def note_rest(self) -> None:
        """Tell the process if every output is at its safe value by now. From any thread, and from signal handlers."""
        number = next(self._numbers)
        if not self._acting_since():
            self._write(f"rests {number}\n")

    def close(self, *, is_safe: bool) -> None:
        """Let the process end; unless every output is safe, it makes them so when this process ends."""
        self._is_closed = True
        process = self._process
        if process is None or not is_safe:
            return
        self._write("done\n")
        with suppress(subprocess.TimeoutExpired):
            process.wait(ENDS_WITHIN_S)
        _end(process)

    def _acting_since(self) -> list[float]:
        return [since_s for each in self._outputs if (since_s := each.acts_since_s()) is not None]

    def _start_again(self) -> None:
        if self._process is not None:
            _end(self._process)
        try:
            self.start()
        except DriverError as error:
            self.lost, self._is_reported = str(error), False
            return
        self.lost, self._is_reported = "", False
        for output in self._outputs:
            output.is_held = False

    def _lose(self, why: str) -> None:
        """Stop every output, since nothing would make them safe if we died; the next cycle reports it."""
        if self.lost or self._is_closed:
            return
        self.lost = why
        for output in self._outputs:
            output.is_held = True
        for trouble in make_all_safe(self._outputs):
            self._tell(f"warning: {trouble}")

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Count answers until the process ends, however it does."""
        assert process.stdout  # noqa: S101 - for the type checker
        with process.stdout:
            while heard := os.read(process.stdout.fileno(), 4096):
                if process is self._process:
                    self._answered += len(heard)
                    self._heard_s = time.monotonic()
        if process is self._process:
            self._lose("the watchdog process has ended")

    def _write(self, words: str) -> None:
        """Write without waiting. What a process does not take any more, shows by its answers."""
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError, ValueError):
                os.write(self._process.stdin.fileno(), words.encode())

    @staticmethod
    def _is_ready(process: subprocess.Popen[bytes]) -> bool:
        assert process.stdout  # noqa: S101 - for the type checker
        found = select.select([process.stdout], [], [], STARTS_WITHIN_S)[0]
        return bool(found) and os.read(process.stdout.fileno(), 64) == b"ready\n"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a watchdog process. Its answers are closed by what reads them."""
    process.kill()
    process.wait()
    assert process.stdin  # noqa: S101 - for the type checker
    with suppress(OSError):
        process.stdin.close()


def _is_release(command: AnyCommand) -> bool:
    return isinstance(command, OperatorCommand) and command.action is OperatorAction.RELEASE_OUTPUTS
