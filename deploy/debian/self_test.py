"""Tries a version before it is run: ``python3 self_test.py CURRENT CONFIGURATION``, with the Python of the new version.

A trouble that the version in CURRENT has as well, or that the system's own Python has, is a warning: it is no reason to
stay with the old version. Any other fails the test, with exit code 1 and one sentence at the standard output.
"""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

LIBRARIES = (
    "numpy",
    "cv2",
    "simplejpeg",
    "msgspec",
    "pydantic",
    "serial",
    "gpiozero",
    "paho.mqtt.client",
    "mcap",
    "zstandard",
)
OF_THE_SYSTEM = ("lgpio", "libcamera", "picamera2")
"""What may be there, and is built by others: the numpy that it was built for need not be ours."""

SCENE = Path(__file__).with_name("self-test.toml")
DISTANCE_M = 1.5
"""Of the ball in the scene, along the floor; the camera stands as high as the ball's centre."""
TOLERANCE_M = 0.02


class FailedError(Exception):
    """What is wrong, in a sentence."""


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, whatever that is."""
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=120, check=False)  # noqa: S603


def last_line(done: subprocess.CompletedProcess[str]) -> str:
    """Return what a command said last, which of a traceback is the error."""
    return ((done.stderr or done.stdout).strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def warn(words: str) -> None:
    """Say what is wrong and no fault of this version."""
    print(f"stadimeter: {words}", file=sys.stderr)


def import_libraries() -> None:
    """Load what came with the package."""
    for name in LIBRARIES:
        try:
            importlib.import_module(name)
        except Exception as error:
            raise FailedError(f"the library {name} cannot be loaded: {error}") from error


def import_system_libraries() -> None:
    """Load what the system has for pins and ribbon cameras, in a process each: some of it ends the process."""
    for name in OF_THE_SYSTEM:
        if find_spec(name) is None:
            continue
        ours = run(sys.executable, "-s", "-c", f"import {name}")
        if ours.returncode == 0:
            continue
        if run(Path("/usr/bin/python3"), "-s", "-c", f"import {name}").returncode == 0:
            raise FailedError(
                f"the system's {name} does not work with the libraries of this version: {last_line(ours)}"
            )
        warn(f"the system's {name} does not work, with this version or without: {last_line(ours)}")


def measure() -> None:
    """Measure a simulated ball at a known distance, with the whole program."""
    journal = Path("self-test.jsonl")
    options = ("--frames", "5", "--speed", "0", "--no-state", "--journal", journal, "--json")
    done = run(sys.executable, "-s", "-m", "stadimeter", "run", SCENE, *options)
    if done.returncode:
        raise FailedError(f"a simulated run ended with exit code {done.returncode}: {last_line(done)}")
    measured = json.loads(journal.read_text().splitlines()[-1])["observation"]["measurements"][0]
    distance_m = measured["distance_m"]
    if distance_m is None or abs(distance_m - DISTANCE_M) > TOLERANCE_M:
        raise FailedError(f"a simulated ball at {DISTANCE_M} m is measured at {distance_m} m")


def check(current: Path, configuration: Path) -> None:
    """Check the configuration as a run would load it, if it can be used now."""
    if not configuration.exists():
        return
    words = ("-s", "-m", "stadimeter", "check", configuration)
    ours = run(sys.executable, *words, "--elsewhere")
    theirs = current / "bin/python3"
    lacks = run(sys.executable, *words)
    if theirs.exists() and (lacking := _lacking(lacks) - _lacking(run(theirs, *words))):
        said = [line for line in (lacks.stdout + lacks.stderr).splitlines() if any(each in line for each in lacking)]
        raise FailedError("\n".join((f"{configuration} needs what the version that runs has:", *said)))
    if ours.returncode == 0:
        return
    sentence = (ours.stderr or ours.stdout).strip()
    if theirs.exists() and run(theirs, *words, "--elsewhere").returncode == 0:
        raise FailedError(f"it cannot use {configuration}, and the version that runs can:\n{sentence}")
    warn(f"the configuration cannot be used:\n{sentence}")


def _lacking(checked: subprocess.CompletedProcess[str]) -> set[str]:
    """Return the libraries that a check says are not installed."""
    return set(re.findall(r"the library (\S+) is not installed", checked.stdout + checked.stderr))


def main(current: str, configuration: str) -> None:
    """Try everything, the quickest first."""
    try:
        import_libraries()
        import_system_libraries()
        measure()
        check(Path(current), Path(configuration))
    except Exception as trouble:  # noqa: BLE001 - whatever it is, the old version stays and says why
        kind = () if isinstance(trouble, FailedError) else (f"{type(trouble).__name__}:",)
        print(*kind, *str(trouble).split())
        sys.exit(1)


if __name__ == "__main__":
    main(*sys.argv[1:])
