"""The README says how much of the disk the program and its libraries take."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

README = Path(__file__).parents[2] / "README.md"
MEGABYTE = 2**20


def with_libraries(name: str, extras: frozenset[str], found: dict[str, Distribution]) -> dict[str, Distribution]:
    """Return a distribution and all that it requires here, by name."""
    found[name] = distribution(name)
    for each in map(Requirement, found[name].requires or ()):
        is_wanted = each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in {"", *extras})
        if is_wanted and each.name not in found:
            with_libraries(each.name, frozenset(each.extras), found)
    return found


def size_mb(one: Distribution) -> float:
    files = (Path(str(one.locate_file(each))) for each in one.files or () if each.suffix != ".pyc")
    return sum(file.stat().st_size for file in files if file.is_file()) / MEGABYTE


def test_the_installation_takes_what_the_readme_says() -> None:
    (said,) = re.findall(r"installs about (\d+) MB into", README.read_text(encoding="utf-8"))
    libraries = with_libraries("stadimeter", frozenset({"web"}), {})
    taken_mb = sum(map(size_mb, (*libraries.values(), distribution("pip"))))
    assert 0.75 * float(said) < taken_mb < 1.1 * float(said)
