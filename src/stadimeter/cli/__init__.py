"""The command line, one file per group of commands."""

from stadimeter.cli.main import main

__all__ = ["main"]
