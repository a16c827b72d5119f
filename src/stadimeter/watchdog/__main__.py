"""The watchdog process, and `safe-outputs`: ``python3 -I -S __main__.py hold PID``, or ``… safe-outputs [FILE …]``.

``hold`` is started by a run, before it opens an output. What the run writes to its standard input, a line each:

    pin …, serial …, i2c …    what makes each output safe; see `stadimeter.watchdog.plan`
    limit SECONDS             for how long after its capture a picture may move anything; the first one ends the plan
    acts NUMBER SENT AGE      at the end of a cycle: an output acts, on data of this age in seconds, at this time
    rests NUMBER              every output is at its safe value
    done                      every output was stopped and closed: end, without doing anything

Several threads write these two; one that arrives after another with a higher number is older, and is passed over.

It answers ``ready`` to the plan, and a dot to each ``acts``. When the run dies, it makes every output safe. While an
output acts, it must hear of newer data, or that the outputs rest, before the data is older than the limit; else the run
hangs with all its threads, or is stopped, and is killed first. All its signals are blocked by the run, so that neither
Ctrl-C nor systemd's SIGTERM to all processes of a service ends it before the run has ended.

Times are of CLOCK_MONOTONIC, which stands still while the computer sleeps.
"""

from __future__ import annotations

import os
import select
import sys
import time

if not __package__:  # started by its path, with -I and -S
    sys.path.append(__file__.rsplit("/", 3)[0])

from stadimeter.watchdog.gpio import drive_pins
from stadimeter.watchdog.plan import NO_LIST, SafePlan, read_lists
from stadimeter.watchdog.stops import make_safe

LISTS = ["/run/stadimeter/safe-outputs.conf", "/etc/stadimeter/safe-outputs.conf"]

SIGKILL = 9

# The stop is sent at once, and again when the run is gone and has let go of its ports and pins: until then it may
# finish a call to a driver. A process that is killed on a busy computer may need as long as this.
GONE_WITHIN_S = 1.0

# A look that came this late: this process was stopped too, with the run it may be. Then the run gets as long to speak.
LATE_S = 0.1


class RunWatch:
    """Watches over a process until it ends, hangs, or says that it is done.

    Attributes:
        plan: What makes its outputs safe.
        is_done: Whether it has stopped and closed its outputs itself.
    """

    def __init__(self, pid: int, source: int = 0, answers: int = 1) -> None:
        self.plan = SafePlan([])
        self.is_done = False
        self._source = source
        self._answers = answers
        self._process = os.pidfd_open(pid)
        self._is_gone = os.getppid() != pid
        self._limit_s = 0.0
        self._newest = 0.0
        self._due_s: float | None = None
        self._lines: list[str] = []
        self._rest = b""

    def run(self) -> str:
        """Return why the outputs must be made safe, in words; empty if the run has done that itself."""
        while not self._is_gone and not self.is_done:
            now_s = time.monotonic()
            left_s = None if self._due_s is None else max(0.0, self._due_s - now_s)
            heard, _, _ = select.select([self._source, self._process], [], [], left_s)
            if self._process in heard:
                self._is_gone = True
            if self._source in heard:
                self._is_gone = not self._hear()
            elif not heard:
                if time.monotonic() - now_s - (left_s or 0.0) <= LATE_S:
                    return self._kill()
                self._due_s = time.monotonic() + LATE_S
        while not self.is_done and self._hear():  # its last words, which may be that it is done
            pass
        return "" if self.is_done else "the program has ended without stopping its outputs"

    def _kill(self) -> str:
        # Part of the interpreter: no disk is read now. `signal` itself would load `enum`.
        import _signal  # type: ignore[import-not-found] # noqa: PLC0415

        _signal.pidfd_send_signal(self._process, SIGKILL)
        return f"the program hung with an output acting on data older than {self._limit_s:g} s, and was killed"

    def waits_until_gone(self, within_s: float) -> bool:
        """Check whether the run is gone, or is within so long."""
        return bool(select.select([self._process], [], [], within_s)[0])

    def _hear(self) -> bool:
        """Take in what the run says; return whether it may say more."""
        data = os.read(self._source, 65536)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line.decode("latin-1"))
        return bool(data)

    def _take(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word in {"acts", "rests"}:
            self._take_report(*map(float, rest.split()))
        elif word == "limit":
            is_first, self._limit_s = not self._limit_s, float(rest)
            if is_first:
                self.plan = SafePlan(self._lines)
                self._answer(b"ready\n")
        elif word == "done":
            self.is_done = True
        else:
            self._lines.append(line)

    def _take_report(self, number: float, sent_s: float | None = None, age_s: float = 0.0) -> None:
        """Take in at what time which data moved the outputs; without them, that all are at their safe value."""
        if sent_s is not None:
            self._answer(b".")
        if number > self._newest:
            self._newest = number
            self._due_s = None if sent_s is None else sent_s - age_s + self._limit_s

    def _answer(self, words: bytes) -> None:
        try:
            os.write(self._answers, words)
        except OSError:  # the run is gone: the next look finds that
            return


def hold(pid: int) -> None:
    """Watch over a run, and make its outputs safe when it cannot."""
    watch = RunWatch(pid)
    why = watch.run()
    if why:
        is_gone = watch.waits_until_gone(0.0)
        complaints = make_safe(watch.plan)
        if not is_gone:
            watch.waits_until_gone(GONE_WITHIN_S)
            complaints = make_safe(watch.plan)
        wrong = [*watch.plan.complaints, *complaints]
        _say("watchdog", [f"{why}: its outputs {'were made safe' if not wrong else 'are NOT all safe'}", *wrong])


def safe_outputs(arguments: list[str]) -> None:
    """Make safe what lists of outputs name, or with ``--check`` print what would drive the pins."""
    is_check = arguments[:1] == ["--check"]
    lines, wrong = read_lists(arguments[is_check:] or LISTS)
    plan = SafePlan(lines)
    _say("safe-outputs", [*(each for each in wrong if not (is_check and each == NO_LIST)), *plan.complaints])
    if is_check:
        print(drive_pins(plan.pins, [], is_check=True) if plan.pins else "no pins")
    else:
        _say("safe-outputs", make_safe(plan))


def _say(who: str, lines: list[str]) -> None:
    text = "".join(f"{who}: {line}\n" for line in lines)
    try:
        os.write(2, text.encode(errors="replace"))
    except OSError:  # nobody reads it
        return


def main(arguments: list[str]) -> None:
    """Do what is asked for, and leave at once: a part that hangs holds up nothing."""
    if arguments[:1] == ["hold"]:
        hold(int(arguments[1]))
    else:
        safe_outputs(arguments[1:])
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
