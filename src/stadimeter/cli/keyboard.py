"""Keys while a run is shown: what each does, and the terminal that gives them one by one."""

from __future__ import annotations

import os
import select
import termios
import tty
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

from msgspec import Struct, field

from stadimeter.app.loop import Loop

# While a run is paused, its view is drawn this often, for a window that changes its size.
LOOK_EVERY_S = 0.2


class Keyboard:
    """The terminal at standard input, which gives each key at once and without echo while in the context.

    Without a terminal, or with one that belongs to another program because this one runs in the background, no key is
    ever pressed. Ctrl-C and Ctrl-Z stay signals.
    """

    def __init__(self, descriptor: int = 0) -> None:
        self._descriptor = descriptor
        self._before: list[object] | None = None

    @property
    def is_there(self) -> bool:
        """True if keys can be pressed."""
        return self._before is not None

    def __enter__(self) -> Self:
        """Take the terminal."""
        if self._is_ours():
            with suppress(termios.error):
                self._before = termios.tcgetattr(self._descriptor)
                tty.setcbreak(self._descriptor, termios.TCSANOW)
        return self

    def __exit__(self, *_error: object) -> None:
        """Give the terminal back as it was."""
        self.restore()

    def restore(self) -> None:
        """Give the terminal back as it was, for good. May be called any number of times, and by a signal handler."""
        if self._before is not None and self._is_ours():
            with suppress(termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSANOW, self._before)  # type: ignore[arg-type]
        self._before = None

    def pressed(self, wait_s: float = 0.0) -> str:
        """Return the keys that were pressed since the last call, small letters; wait so long for one.

        An arrow or function key sends several characters that begin with Escape. They are no keys of ours.
        """
        if not self.is_there or not self._is_ours():
            select.select([], [], [], wait_s)
            return ""
        try:
            if termios.tcgetattr(self._descriptor)[3] & termios.ICANON:  # Ctrl-Z gave it to a shell, which left it so
                tty.setcbreak(self._descriptor, termios.TCSANOW)
            if not select.select([self._descriptor], [], [], wait_s)[0]:
                return ""
            data = os.read(self._descriptor, 1024)
        except (OSError, termios.error):  # the terminal is gone
            data = b""
        if not data:
            self._before = None
        return "" if data.startswith(b"\x1b") else data.decode("ascii", "ignore").lower()

    def _is_ours(self) -> bool:
        try:
            return os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:  # no terminal
            return False


class Key(Struct, frozen=True, kw_only=True):
    """A key, and what it does.

    Attributes:
        presses: The characters that stand for it.
        name: What it is called on the screen.
        does: What it does, in a word or three.
        undoes: What it does when pressed again; empty if it does the same.
        is_on: Whether it would undo now.
    """

    presses: str
    name: str
    does: str
    act: Callable[[], None]
    undoes: str = ""
    is_on: Callable[[], bool] = bool

    @property
    def words(self) -> str:
        """The words for what it would do now."""
        return self.undoes if self.undoes and self.is_on() else self.does


class RunKeys(Struct):
    """The keys of a run that is shown: to end it, to explain the screen, and what else there is.

    Args:
        more: Further keys.
        can_pause: Whether the run may be held up: one on a stepped clock, whose time stands still meanwhile.
    """

    loop: Loop
    more: Sequence[Key] = ()
    can_pause: bool = False
    keyboard: Keyboard = field(default_factory=Keyboard)
    is_paused: bool = False
    is_explained: bool = False

    @property
    def keys(self) -> tuple[Key, ...]:
        """All of them; none if there is no keyboard."""
        if not self.keyboard.is_there:
            return ()
        end = Key(presses="q", name="q", does="quit", act=lambda: self.loop.end("the key q was pressed"))
        explain = Key(
            presses="?", name="?", does="help", undoes="back", act=self._explain, is_on=lambda: self.is_explained
        )
        pause = Key(
            presses=" p", name="space", does="pause", undoes="go on", act=self._pause, is_on=lambda: self.is_paused
        )
        return (end, explain, *([pause] if self.can_pause else []), *self.more)

    def attend(self, draw: Callable[[], None]) -> None:
        """Do what keys ask for, and draw what comes of it. While the run is paused, this returns only at its end."""
        if self._take(0.0):
            draw()
        while self.is_paused and not self.loop.ending:
            self._take(LOOK_EVERY_S)
            draw()

    def _take(self, wait_s: float) -> bool:
        pressed = self.keyboard.pressed(wait_s)
        meant = [key for press in pressed for key in self.keys if press in key.presses]
        for key in meant:
            key.act()
        return bool(meant)

    def _explain(self) -> None:
        self.is_explained = not self.is_explained

    def _pause(self) -> None:
        self.is_paused = not self.is_paused
