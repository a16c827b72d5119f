"""Writing the files of the setup. What was there is kept as a version."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import stadimeter
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.saving import save_files


def write_files(folder: Path, files: Mapping[str, str]) -> Iterator[str]:
    """Write files; yield a sentence for each. One that would stay the same is left alone.

    Raises:
        ConfigError: A file cannot be written there; then none is.
    """
    written, kept = save_files(folder, files)
    for name in files:
        path = folder / name
        if name not in written:
            path.touch()  # newer than the answers, as `was_left` wants it
            yield f"{path} is as it was"
        else:
            was_there = kept is not None and (kept / name).exists()
            yield f"wrote {path}{f'; the one that was there is {kept / name} now' if kept and was_there else ''}"


def was_left(answers: Path, configuration: Path) -> bool:
    """Return whether an interview was left before its end: its answers are newer than what came of the last one."""
    answered_ns = _modified_ns(answers)
    return answered_ns is not None and answered_ns > (_modified_ns(configuration) or 0)


def _modified_ns(path: Path) -> int | None:
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return None


def example(name: str) -> str:
    """Return an example configuration that comes with the program.

    Raises:
        ConfigError: There is none of that name; it lists them.
    """
    folder = Path(stadimeter.__file__).parent / "configurations"
    texts = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    if name not in texts:
        raise ConfigError([Problem(f"there is no example {name!r}, only {', '.join(texts)}", key="--example")])
    return texts[name].read_text(encoding="utf-8")
