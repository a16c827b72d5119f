"""Commands as a user types them, in this process: one of its own takes a second to start."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from typer.testing import CliRunner

from stadimeter.cli.main import app


class Typed(Struct):
    """What came of a command."""

    returncode: int
    stdout: str
    stderr: str


def typed(*words: object, env: Mapping[str, str] | None = None, answers: str | None = None) -> Typed:
    """Type a command behind ``stadimeter``; what it does not catch itself is raised here, where a user had a traceback.

    Args:
        env: What the environment has besides; the screen is 100 columns wide unless it says so.
        answers: What is typed when it asks.
    """
    around = {"NO_COLOR": "1", "COLUMNS": "100", **(env or {})}
    done = CliRunner().invoke(app, [str(word) for word in words], env=around, prog_name="stadimeter", input=answers)
    if done.exception and not isinstance(done.exception, SystemExit):
        raise done.exception
    return Typed(done.exit_code, done.stdout, done.stderr)
