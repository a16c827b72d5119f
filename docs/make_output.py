"""Runs the commands that a guide shows, and writes what they print into it.

``python docs/make_output.py docs/rules.md`` writes; with ``--check`` it only compares, and leaves with 1 if something
else is printed than what is shown. What a guide shows is run in an empty folder, from top to bottom:

- a block that follows ``<!-- file: NAME -->`` is written to that file;
- in a block of ``console``, each line that begins with ``$`` is run, and what follows is what it printed;
- a block of ``sh`` is run, and must leave with 0;
- ``<!-- run: COMMAND -->`` is run and not shown: what a reader does in another window. ``$SOURCE`` is this checkout;
- a block that follows ``<!-- run by: TEST FILE -->`` is not run here: that test does it, since it needs a device, the
  rights of root, or somewhere to run on.

How long something took differs from run to run, so figures in milliseconds are not compared.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1]
BLOCK = re.compile(
    r"^<!-- run: (?P<unseen>[^\n]+) -->$"
    r"|(?:^<!-- file: (?P<name>[\w./-]+) -->\n)?(?:^<!-- run by: (?P<by>[\w./-]+) -->\n)?"
    r"^```(?P<kind>\w*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
FROM_RUN_TO_RUN = re.compile(r"[\d.]+(?= (?:ms|s\b.* took))|\d{8}T\d{6}Z")  # how long it took, and when it was


def with_output(guide: str, folder: Path) -> str:
    """Run what a guide shows.

    Args:
        guide: The text of the guide.
        folder: Where to run it.

    Returns:
        The same text with what was printed now.
    """

    def run_block(found: re.Match[str]) -> str:
        if found["unseen"]:
            printed(found["unseen"], folder)
        if found["name"]:
            (folder / found["name"]).write_text(found["text"])
        if found["kind"] == "sh" and not found["by"]:
            printed(found["text"], folder, must_pass=True)
        if found["kind"] != "console" or found["by"]:
            return found[0]
        commands = [line[2:] for line in found["text"].splitlines() if line.startswith("$ ")]
        return "```console\n" + "".join(f"$ {command}\n{printed(command, folder)}" for command in commands) + "```"

    return BLOCK.sub(run_block, guide)


def printed(command: str, folder: Path, must_pass: bool = False) -> str:
    """Run a command, and return what it prints on both its outputs.

    Raises:
        SystemExit: It did not leave with 0, and must.
    """
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    around = {**os.environ, "PATH": path, "NO_COLOR": "1", "COLUMNS": "130", "TZ": "UTC", "LC_ALL": "C.UTF-8"}
    around["STADIMETER_PROGRESS"] = "off"  # whether it is shown depends on how busy this computer is
    around["SOURCE"] = str(SOURCE)
    around["XDG_RUNTIME_DIR"] = str(folder)  # a running instance is found by itself, and only the guide's own
    done = subprocess.run(  # noqa: S603 - a guide of our own is run
        ["bash", "-e", "-c", command],  # noqa: S607 - whichever shell people have
        cwd=folder,
        env=around,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if must_pass and done.returncode:
        raise SystemExit(f"this left with {done.returncode}:\n{command}\n{done.stdout}")
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    return "".join(f"{line}\n" for line in lines)


def comparable(text: str) -> list[str]:
    """Return the lines of a guide without what differs from run to run."""
    return FROM_RUN_TO_RUN.sub("…", text).splitlines()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for.

    Args:
        arguments: What stands on the command line.

    Returns:
        0; with ``--check`` 1 if something else is printed than what is shown.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("guide", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing, and say what differs")
    asked = parser.parse_args(arguments)
    shown = asked.guide.read_text()
    with tempfile.TemporaryDirectory() as folder:
        now = with_output(shown, Path(folder))
    if not asked.check:
        asked.guide.write_text(now)
        return 0
    differences = list(difflib.unified_diff(comparable(shown), comparable(now), "shown", "printed", lineterm=""))
    print("\n".join(differences))
    return 1 if differences else 0


if __name__ == "__main__":
    raise SystemExit(main())
