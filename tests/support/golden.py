"""Golden files: what the program answered when they were made, a line for each part, so that a change says where it is.

`make golden` writes them anew. A figure is kept to six digits: more of them would tell one processor from another.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct
from msgspec.structs import asdict

KEPT = Path(__file__).parents[1] / "golden" / "kept"
SHOWN = 20
DIGITS = 6
NOTHING = 1e-9
"""A figure that is smaller than this is the rest of a difference of two that are equal."""


class Golden:
    """The golden files, to compare with or to write.

    Args:
        is_written: Whether they are written instead of compared.
    """

    def __init__(self, *, is_written: bool) -> None:
        self.is_written = is_written

    def compare(self, name: str, rows: Mapping[str, str], is_same: Callable[[str, str], bool] = str.__eq__) -> None:
        """Compare with a golden file; fail with the lines that differ.

        Args:
            name: The file, without its ending.
            rows: Its lines: by the part, what came of it.
            is_same: Takes what was kept and what came; whether they are the same.
        """
        path = KEPT / f"{name}.txt"
        if self.is_written:
            path.write_text("".join(f"{part}\t{what}\n" for part, what in rows.items()), encoding="utf-8")
            return
        kept = self.kept(name)
        differing = [
            f"{part}\n  kept: {kept.get(part, 'no such line')}\n  now:  {rows.get(part, 'no such part')}"
            for part in {**kept, **rows}
            if part not in kept or part not in rows or not is_same(kept[part], rows[part])
        ]
        if differing:
            text = "\n".join(differing[:SHOWN])
            pytest.fail(
                f"{len(differing)} of {len({**kept, **rows})} lines of {path.name} differ; if that is what you want, "
                f"write it anew: make golden ARGS='-k {name.partition('-')[0]}'\n{text}",
                pytrace=False,
            )

    def kept(self, name: str) -> dict[str, str]:
        """Return the lines of a golden file by their parts; empty if it is to be written."""
        path = KEPT / f"{name}.txt"
        if self.is_written or not path.exists():
            return {}
        return dict(line.split("\t", 1) for line in path.read_text(encoding="utf-8").splitlines())


def told(value: Any) -> Any:
    """Return what JSON can say of a value, with its figures to `DIGITS` digits."""
    if isinstance(value, bool | str | int | None):
        return value
    if isinstance(value, float):
        return 0.0 if abs(value) < NOTHING else float(f"{value:.{DIGITS}g}")
    if isinstance(value, Struct):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(told(key)): told(inner) for key, inner in value.items()}
    inside = [told(inner) for inner in value]
    return sorted(inside) if isinstance(value, set | frozenset) else inside


def digest(value: Any) -> str:
    """Return twelve letters that differ where a value differs."""
    text = json.dumps(told(value), ensure_ascii=True, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
