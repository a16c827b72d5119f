"""JavaScript keeps the line length of the house: `make check` formats and lints it, but breaks no long text."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
LINE_MAX = 120
OURS = [path for room in ("src", "tests") for path in sorted((ROOT / room).rglob("*.js")) if "vendor" not in path.parts]


def test_no_line_of_javascript_is_longer_than_a_line_of_python() -> None:
    assert OURS
    long = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in OURS
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > LINE_MAX
    ]
    assert long == []
