"""Restarts in the same process, with a configuration that a reload cannot apply.

The file is read and checked first, and everything that it names is built: the answer says what is wrong, and the
run goes on. Only then the run ends as at SIGTERM, its outputs first, and the program begins again with the same command
line. It keeps its process id, so that systemd, and the shell that started it, see one process all the time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from stadimeter.app.control.messages import NoArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.errors import ConfigError, StadimeterError


class Restarter:
    """Checks the configuration again when asked, and then lets the run end.

    Args:
        check: Reads, checks and builds what the run would begin anew with.
    """

    def __init__(self, check: Callable[[], object]) -> None:
        self._check = check
        self._is_checked = False
        self._is_cancelled = False
        self._lock = threading.Lock()

    @property
    def is_due(self) -> bool:
        """Whether the run shall end now, and the program begin anew."""
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
        try:
            self._check()
        except ConfigError as error:
            answer(Reply(error=f"not restarted, since the run could not begin:\n{error}", problems=error.problems))
        except StadimeterError as error:
            answer(Reply(error=f"not restarted, since the run could not begin: {error}"))
        except BaseException as error:  # noqa: BLE001 - a defect in a check must not leave the one who asks waiting
            answer(Reply(error=f"not restarted: the file could not be checked: {type(error).__name__}: {error}"))
        else:
            answer(Reply({"words": "restarting"}))
            self._is_checked = True
            return
        self._lock.release()


def built(configuration: Path) -> object:
    """Build all parts of a run, and open none of them; errors as at the start of a run."""
    from stadimeter.app.bootstrap import build  # noqa: PLC0415 - loaded already, where this is called
    from stadimeter.config.loader import load_configuration  # noqa: PLC0415

    return build(load_configuration(configuration, with_tests=False))
