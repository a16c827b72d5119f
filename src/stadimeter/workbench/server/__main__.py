"""``python -m stadimeter.workbench.server``: started by the page, which writes requests and reads answers."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from stadimeter.workbench.server.operations import Desk
from stadimeter.workbench.server.process import serve


def main() -> None:
    """Answer on a copy of standard output: what a library prints must not get between the answers."""
    parser = argparse.ArgumentParser(prog="python -m stadimeter.workbench.server", description=__doc__)
    parser.add_argument("--configuration", type=Path, required=True)
    parser.add_argument("--socket", type=Path)
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends this by closing the pipe
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    desk = Desk(configuration=options.configuration.resolve(), run_socket=options.socket)
    with os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0) as requests:
        serve(desk, requests, answers)


if __name__ == "__main__":
    main()
