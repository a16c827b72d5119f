"""Writing the files of the setup. What was there is kept as a copy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path

import stadimeter
from stadimeter.config.atomic_file import write_atomically
from stadimeter.errors import ConfigError, Problem


def write_files(folder: Path, files: Mapping[str, str]) -> Iterator[str]:
    """Write files; yield a sentence for each that was written. One that would stay the same is left alone.

    Raises:
        ConfigError: A file cannot be written there.
    """
    for name, text in files.items():
        path = folder / name
        try:
            if path.exists() and path.read_bytes() == text.encode():
                path.touch()  # newer than the answers, as `was_left` wants it
                yield f"{path} is as it was"
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            kept = f"; the one that was there is {_keep(path)} now" if path.exists() else ""
            write_atomically(path, text.encode())
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ConfigError([Problem(f"it cannot be written: {reason}", str(path))]) from error
        yield f"wrote {path}{kept}"


def was_left(answers: Path, configuration: Path) -> bool:
    """Return whether an interview was left before its end: its answers are newer than what came of the last one."""
    if not answers.exists():
        return False
    return not configuration.exists() or answers.stat().st_mtime_ns > configuration.stat().st_mtime_ns


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


def copy_name(path: Path) -> Path:
    """Return a free name for a copy of a file: ``stadimeter.toml.1.bak`` for the first."""
    names = (path.with_name(f"{path.name}.{number}.bak") for number in count(1))
    return next(name for name in names if not name.exists())


def _keep(path: Path) -> Path:
    copy = copy_name(path)
    write_atomically(copy, path.read_bytes())
    return copy
