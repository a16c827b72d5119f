"""Every error that stadimeter raises on purpose.

::

    StadimeterError
    ├─ UnreadableError (OSError)             a file that is not there, not regular, too large, or not text
    ├─ ConfigError (ValueError)              a configuration, camera file or option is wrong; lists every problem
    │  └─ DemonstrationError                 the demonstration's configuration, which nothing changes
    ├─ ChangedMeanwhileError                 a file was saved by another since it was read
    ├─ NotThereError (LookupError)           a recording or a version that is asked for by a name, and is not there
    ├─ CommandRangeError (ValueError)        a command that no actuator could follow: NaN, or outside its range
    ├─ CalibrationError (ValueError)         a camera model that cannot be made, or does not fit the pictures
    ├─ PictureError (ValueError)             a picture or video that cannot be read
    ├─ JournalError (OSError)                a journal that cannot be written or read
    ├─ StateError (OSError)                  a state file that cannot be written or read
    ├─ ControlError (ConnectionError)        a running instance that is not there, does not answer, or refuses
    ├─ PageError                             a request of the page that is refused, or cannot be answered
    ├─ EndOfFramesError                      a recording came to its end: a normal end, not a fault
    └─ DriverError
       ├─ DriverNotFoundError (LookupError)      no driver has that name
       ├─ DriverUnavailableError (ImportError)   the driver exists, but a library that it needs does not
       ├─ DeviceOpenError (OSError)              a device is absent, busy or not allowed
       │  └─ DeviceHungError                         only the end of this process lets it go
       ├─ DeviceClosedError                      a device was used before it was opened or after it was closed
       ├─ CaptureTimeoutError (TimeoutError)     no fresh frame in time
       ├─ LinkLostError (ConnectionError)        a device that answered has stopped answering
       └─ ProtocolError                          bytes that make no sense

Each error is also the built-in that fits it, so that callers may catch either. A message says what is wrong, where,
and what to do about it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msgspec import Struct


class StadimeterError(Exception):
    r"""The root of every error that stadimeter raises on purpose.

    Its text can be written anywhere. A file's name is bytes, and where they are no text Python keeps them as lone
    surrogates, at which journals, messages and terminals would fail; they are shown as ``\udcff``.
    """

    def __str__(self) -> str:
        """Return the message."""
        return super().__str__().encode("utf-8", "backslashreplace").decode("utf-8")


class UnreadableError(StadimeterError, OSError):
    """A file is not there, is no regular file, is larger than its kind can be, or is not text.

    The reader of the file knows what it should be, and raises an error of its own from this one.

    Attributes:
        reason: What is wrong, without the path, such as ``there is no such file``.
        line: The line, counted from 1, or 0 where it is not known.
    """

    def __init__(self, path: object, reason: str, line: int = 0) -> None:
        self.reason = reason
        self.line = line
        super().__init__(f"{path}{f':{line}' if line else ''}: {reason}")


class Problem(Struct, frozen=True):
    """One thing that is wrong in a configuration.

    Attributes:
        file: The file it stands in, or an empty string for an option of the command line.
        line: The line in that file, counted from 1, or 0 where it is not known.
        key: The dotted path of the key, such as ``rules.near.when.below``.
        hint: What to do about it, or an empty string.
        code: The kind of problem, such as ``never-true``, for programs; it stays the same when the words change.
        column: Where the key begins in the line, counted from 0.
        end_column: Where its value ends in the line, exclusive; 0 where that is not known.
    """

    message: str
    file: str = ""
    line: int = 0
    key: str = ""
    hint: str = ""
    code: str = ""
    column: int = 0
    end_column: int = 0

    def __str__(self) -> str:
        """Return the problem as one line: ``file:line: key: message (hint)``."""
        place = ":".join(part for part in (self.file, str(self.line) if self.line else "") if part)
        text = ": ".join(part for part in (place, self.key, self.message) if part)
        return f"{text} ({self.hint})" if self.hint else text


class ConfigError(StadimeterError, ValueError):
    """A configuration, a camera file or an option of the command line is wrong."""

    def __init__(self, problems: Iterable[Problem] | str) -> None:
        self.problems = (Problem(problems),) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class DemonstrationError(ConfigError):
    """A request that would change the configuration of the demonstration.

    Attributes:
        code: What it is, for programs.
    """

    code = "demonstration"


class ChangedMeanwhileError(StadimeterError):
    """A file was saved by another since it was read, and ours would overwrite that.

    Attributes:
        code: What it is, for programs.
    """

    code = "conflict"


class NotThereError(StadimeterError, LookupError):
    """A recording or a version that is asked for by its name is not there."""

    code = "not-found"


class CommandRangeError(StadimeterError, ValueError):
    """A command holds a value that no actuator could follow: NaN, infinite, or outside its range."""


class CalibrationError(StadimeterError, ValueError):
    """A camera model cannot be made from the given pictures, or does not fit a picture's resolution.

    Attributes:
        key: The key of a camera file that is wrong, or an empty string if it is none in particular.
    """

    def __init__(self, message: str, key: str = "") -> None:
        self.key = key
        super().__init__(message)


class PictureError(StadimeterError, ValueError):
    """A picture or a video cannot be read."""


class JournalError(StadimeterError, OSError):
    """A journal cannot be written or read."""


class StateError(StadimeterError, OSError):
    """A state file cannot be written or read."""


class ControlError(StadimeterError, ConnectionError):
    """A running instance is not there, does not answer, or refuses a command."""


class PageError(StadimeterError):
    """A request that the page refuses, or that neither the run nor the workbench could answer.

    Attributes:
        status: The status that HTTP has for it.
        code: The kind of error, for programs; it stays the same when the words change.
        details: What else is known: ``problems``, or how another's text differs.
    """

    def __init__(self, status: int, code: str, message: str, details: Mapping[str, object] | None = None) -> None:
        self.status = status
        self.code = code
        self.details = dict(details or {})
        super().__init__(message)


class EndOfFramesError(StadimeterError):
    """A recording has come to its end. A normal end of a run, not a fault."""


class DriverError(StadimeterError):
    """A driver or the device behind it failed."""


class DriverNotFoundError(DriverError, LookupError):
    """No driver of that name is installed."""


class DriverUnavailableError(DriverError, ImportError):
    """The driver exists, but a library that it needs is not installed."""


class DeviceOpenError(DriverError, OSError):
    """A device is absent, in use by another program, or this user may not open it."""


class DeviceHungError(DeviceOpenError):
    """A device is still held by this process, whose driver does not let it go: only the end of the process does."""


class DeviceClosedError(DriverError):
    """A device was used before it was opened or after it was closed."""


class CaptureTimeoutError(DriverError, TimeoutError):
    """A camera delivered no fresh frame in time."""


class LinkLostError(DriverError, ConnectionError):
    """A device that answered before has stopped answering."""


class ProtocolError(DriverError):
    """A device sent bytes that make no sense, or refused a command."""


def reason_of(error: OSError) -> str:
    """Return why the system refused, in its own words, such as ``no space left on device``."""
    return (error.strerror or str(error)).lower()
