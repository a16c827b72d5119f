"""The end of a run: on a signal the outputs stop at once, inside the handler; then one deadline holds for all.

An end that is asked for (SIGTERM, Ctrl-C) takes two seconds at most: then systemd kills. Each part of the end
takes what it needs of that time, and no part has a limit of its own that another one could add to. Parts are closed
side by side; one that does not come back is left behind, with a warning.

SIGHUP means one of two things. To a process with a terminal it says that the terminal is gone: a window was closed, an
ssh connection dropped, tmux was ended. Then the run ends, wherever its standard input comes from. A service has no
terminal: to it, SIGHUP says that its configuration has changed.
"""

from __future__ import annotations

import errno
import math
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

from stadimeter.errors import DriverError

# After the end was asked for, nothing is waited for any longer than this.
END_WITHIN_S = 1.3

LOOK_EVERY_S = 0.02

# What is closed one after the other, the last one first, with the name of each.
Steps = list[tuple[str, Callable[[], object]]]


class Deadline:
    """Until when a run must have ended: without limit, until its end is asked for."""

    def __init__(self) -> None:
        self._by_s = math.inf

    def set(self) -> None:
        """Note that the end is asked for. Asking again changes nothing."""
        self._by_s = min(self._by_s, time.monotonic() + END_WITHIN_S)

    @property
    def is_set(self) -> bool:
        """True if the end was asked for."""
        return self._by_s < math.inf

    def left_s(self, wish_s: float, keep_s: float = 0.0) -> float:
        """Return for how long something may be waited for, if ``keep_s`` must be left for others after that."""
        return max(0.0, min(wish_s, self._by_s - time.monotonic() - keep_s))


def close_side_by_side(
    lanes: Mapping[str, Steps], deadline: Deadline, wish_s: float = 30.0, keep_s: float = 0.0
) -> list[str]:
    """Close everything: each lane in a thread of its own, whatever becomes of the others.

    Args:
        deadline: Until when. It may be set while we wait.
        keep_s: How much of the time must be left for others.

    Returns:
        What went wrong, in words, and what was left behind.
    """
    troubles: list[str] = []
    until_s = time.monotonic() + wish_s
    threads = [_closing(steps, troubles) for steps in lanes.values()]
    for thread in threads:
        while thread.is_alive() and deadline.left_s(until_s - time.monotonic(), keep_s) > 0:
            thread.join(LOOK_EVERY_S)
    left = [f"{steps[-1][0]}: it did not end in time, and was left behind" for steps in lanes.values() if steps]
    return [*troubles, *left]


def _closing(steps: Steps, troubles: list[str]) -> threading.Thread:
    """Return the thread that closes a lane; where there is no memory for another thread, it is closed here."""
    thread = threading.Thread(target=_close, args=(steps, troubles), daemon=True)
    try:
        thread.start()
    except (RuntimeError, MemoryError):
        _close(steps, troubles)
    return thread


def _close(steps: Steps, troubles: list[str]) -> None:
    while steps:
        name, close = steps[-1]
        try:
            close()
        except BaseException as error:  # noqa: BLE001 - a defect in one part must not keep the next from being closed
            words = str(error) if isinstance(error, DriverError) else f"{type(error).__name__}: {error}"
            troubles.append(f"{name}: {words}")
        steps.pop()


# A process that still runs this long after a signal is ended, whatever it does.
LAST_RESORT_S = END_WITHIN_S + 0.2

# The last resort takes this long at most: to stop the outputs once more, keep the state and say why.
LAST_WORDS_S = 0.25

# After everything was stopped, the guard goes on for this long: a stop without acknowledgement is repeated.
SETTLE_S = 0.2

# Every signal but SIGHUP, by what a run makes of it. Without a handler, each but the harmless ones would end or stop
# the process with its outputs on.
#
# ==========  ==========================================================================================================
# asking      ends the run
# unasked     ends the run, unless it is ignored or has a handler already: a timer, a limit, a signal sent by mistake
# suspending  puts outputs at their safe values, and then stops the process until SIGCONT; as unasked otherwise
# harmless    nothing: Python ignores the first two, which then are errors of a write, and the system the others
# beyond us   kills or stops the process, or says that it has crashed, after which no code of ours can be relied on
# ==========  ==========================================================================================================
ASKING = (signal.SIGINT, signal.SIGTERM)
UNASKED = (
    *(signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF),
    *(signal.SIGXCPU, signal.SIGIO, signal.SIGPWR, signal.SIGSTKFLT),
    *range(signal.SIGRTMIN, signal.SIGRTMAX + 1),
)
SUSPENDING = (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
HARMLESS = (signal.SIGPIPE, signal.SIGXFSZ, signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH)
BEYOND_US = (
    *(signal.SIGKILL, signal.SIGSTOP),
    *(signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGTRAP, signal.SIGSYS),
)

Handler = Callable[[int, FrameType | None], None]

_ENDED = b"\0"
_ENDING = (*_ENDED, *ASKING, *UNASKED)


@contextmanager
def stopping_on_signals(
    stop: Callable[[str], None],
    reload: Callable[[], bool] = lambda: False,
    give_up: Callable[[], Iterable[str]] = tuple,
    make_safe: Callable[[], Iterable[str]] = tuple,
) -> Iterator[None]:
    """Call ``stop`` with the signal's name when the process is asked to end, and ``make_safe`` before it is suspended.

    Without handlers, signals would end or stop the process with every pin left as it was. A second one ends the
    process at once, after one more stop. So does a first one, with the same exit code of 128 and its number, if the
    process has not ended after `LAST_RESORT_S`: then something hangs that no time-out reaches, such as a terminal that
    does not take the last lines. That works even while the main thread is in a call of C that does not come back.

    Args:
        stop: Stops the outputs and asks the loop to end; called in the main thread.
        reload: Asks the loop to read its configuration again, on SIGHUP in a process without a terminal; returns
            whether it will. If not, the run ends.
        give_up: Stops the outputs and keeps what must be kept before the process is ended as the last resort. Returns
            what went wrong, in words. Called in another thread, and not waited for.
        make_safe: Puts the outputs at their safe values; returns which of them are not, in words. Then the process
            is not suspended. Called in the main thread.

    Yields:
        Nothing; the handlers that were there before are put back afterwards.
    """
    asked: list[int] = []
    heard, tell = os.pipe()
    os.set_blocking(tell, False)
    ends_on_hangup = has_terminal()

    def handle(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP and not ends_on_hangup and reload():
            return
        asked.append(number)
        os.write(tell, _ENDED)
        try:
            stop(_name(number))
        finally:
            if len(asked) > 1:
                os._exit(128 + number)

    is_over = threading.Event()
    watch = threading.Thread(target=_watch, args=(heard, is_over, give_up), name="last resort", daemon=True)
    watch.start()
    ending = [*ASKING, *([signal.SIGHUP] if heeds_hangup() else []), *_default(UNASKED)]
    handlers: dict[int, Handler] = dict.fromkeys(ending, handle)
    handlers |= dict.fromkeys(_default(SUSPENDING), _suspending(make_safe, asked))
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    wakeup = signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        is_over.set()
        os.close(tell)
        watch.join()
        os.close(heard)


def _default(numbers: Iterable[int]) -> Iterator[int]:
    return (number for number in numbers if signal.getsignal(number) == signal.SIG_DFL)


def _suspending(make_safe: Callable[[], Iterable[str]], asked: Sequence[int]) -> Handler:
    """Return the handler that suspends the process, unless its end was ``asked`` for."""

    def suspend(number: int, _frame: FrameType | None) -> None:
        if troubles := [*make_safe()]:
            _say([f"warning: {_name(number)}: not suspended: {trouble}\n" for trouble in troubles])
            return
        time.sleep(SETTLE_S)
        if asked:  # meanwhile: a suspended process would never end
            return
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)  # returns after SIGCONT; at once where there is no shell that could send one
        signal.signal(number, suspend)

    return suspend


def end_with_input() -> None:
    """Have this process end, as SIGTERM ends it, at the end of its standard input.

    That comes when the process that holds the other end of the pipe is gone, however it went. A request to the kernel
    to be killed with the parent would be about the thread that started us, which may end sooner.
    """
    threading.Thread(target=_end_after_input, name="input", daemon=True).start()


def _end_after_input() -> None:
    with suppress(OSError):
        while os.read(0, 1024):
            pass
    os.kill(os.getpid(), signal.SIGTERM)


def has_terminal() -> bool:
    """Check whether the process has a controlling terminal, wherever its standard input and output lead."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError as error:  # what is not known counts as a terminal: then a run ends that could have gone on
        return error.errno not in {errno.ENXIO, errno.ENOENT}
    return True


def heeds_hangup() -> bool:
    """Check whether SIGHUP means anything to us: ``nohup`` has it ignored, for what outlives its terminal."""
    return signal.getsignal(signal.SIGHUP) != signal.SIG_IGN


def _watch(heard: int, is_over: threading.Event, give_up: Callable[[], Iterable[str]]) -> None:
    """End the process if it has not ended in time after a signal. Signals arrive here as bytes, their numbers."""
    while (byte := os.read(heard, 1)) and byte[0] not in _ENDING:
        pass
    if not byte or is_over.wait(LAST_RESORT_S):
        return
    number = byte[0] or signal.SIGHUP
    last = threading.Thread(target=_say_last, args=(_name(number), give_up), daemon=True)
    last.start()
    last.join(LAST_WORDS_S)
    os._exit(128 + number)


def _say_last(name: str, give_up: Callable[[], Iterable[str]]) -> None:
    frames = sys._current_frames()  # noqa: SLF001 - there is no other way to see what another thread does
    hangs = _where(frames.get(threading.main_thread().ident or 0))
    troubles = [f"warning: while ending: {trouble}\n" for trouble in give_up()]
    words = f"error: {name}: ended after {LAST_RESORT_S:.1f} s, before everything was done: this hangs: {hangs}\n"
    _say([*troubles, words])


def _say(lines: Iterable[str]) -> None:
    """Write on standard error, whatever the main thread is doing to it."""
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, "".join(lines).encode(errors="replace"))


def _name(number: int) -> str:
    first = signal.SIGRTMIN
    return signal.Signals(number).name if number <= first else f"SIGRTMIN+{number - first}"


def _where(frame: FrameType | None) -> str:
    """Return where the main thread is, in the deepest code of ours."""
    ours = [each for each in traceback.extract_stack(frame) if f"{os.sep}stadimeter{os.sep}" in each.filename]
    found = ours[-1] if ours else None
    return f"{found.name} in {found.filename}:{found.lineno}" if found else "unknown"
