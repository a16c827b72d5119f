"""Run the command line: ``stadimeter``, or ``python -m stadimeter``."""

from __future__ import annotations

import gc
import os


def main() -> None:
    """Run the command line and leave the process with its exit code.

    Loading libraries makes a hundred thousand objects that stay, and little garbage. The collector would walk through
    all of them again and again, so it rests until the work of a command begins: see `stadimeter.cli.lazy_group`.
    """
    gc.disable()
    # None of our models has plugins. To look for them, pydantic reads a file of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from stadimeter.cli import main as command_line  # noqa: PLC0415 - only now: the collector must rest

    command_line()


if __name__ == "__main__":
    main()
