"""Counts which small mistakes in the code that guards people are noticed by the tests: ``make mutants``.

A mutant is a copy of the source with one mistake in it: another comparison, a sum for a difference, a constant that is
one more, a condition turned round. The tests that cover its line are run, the quick ones first; a mutant that fails one
is killed. What covers a line comes from a run with coverage's contexts, which ``make mutants`` makes first.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import Any

from coverage import CoverageData

GUARDED = ("core", "ranging", "watchdog", "app/guard.py", "app/watchdog.py")
"""What stands between a mistake and a wheel that turns, or a number that is wrong."""

FIRST, MORE = 20, 60
"""How many of the tests that cover a line are run: if the first notice nothing, this many more."""

SECONDS = 120.0

OTHER: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


def mutations(tree: ast.Module) -> Iterator[tuple[int, str, Any]]:
    """Yield the line of each mistake that can be made, its name, and what makes and unmakes it when called."""
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        for field in ("op", "ops"):
            found = getattr(node, field, None)
            swap = OTHER.get(type(found[0] if isinstance(found, list) else found)) if found else None
            if swap:
                yield line, f"{swap.__name__}", (node, field, [swap(), *found[1:]] if field == "ops" else swap())  # type: ignore[index]
        if isinstance(node, ast.If | ast.IfExp):
            yield line, "turned round", (node, "test", ast.UnaryOp(ast.Not(), node.test))
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield line, "other truth", (node, "value", not node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield line, "one more", (node, "value", node.value + 1)
        elif isinstance(node, ast.Return) and node.value is not None:
            yield line, "returns None", (node, "value", ast.Constant(None))


def sample(source: Path, count: int, seed: int) -> list[tuple[str, int]]:
    """Return the file and the number of each mutation of the sample."""
    files = [source / part for part in GUARDED]
    paths = sorted(path for each in files for path in ([each] if each.is_file() else each.rglob("*.py")))
    places = [
        (str(path.relative_to(source)), number)
        for path in paths
        for number, _ in enumerate(mutations(ast.parse(path.read_text(encoding="utf-8"))))
    ]
    return sorted(random.Random(seed).sample(places, count))  # noqa: S311


def mutated(text: str, number: int) -> tuple[str, int, str]:
    """Return the text with one mistake in it, its line, and its name."""
    tree = ast.parse(text)
    line, name, (node, field, value) = list(mutations(tree))[number]
    setattr(node, field, value)
    return ast.unparse(ast.fix_missing_locations(tree)), line, name


class Coverage:
    """The tests that cover a line, cheap ones first."""

    def __init__(self, file: Path, seconds: dict[str, float]) -> None:
        self._data = CoverageData(str(file))
        self._data.read()
        self._files = {path.partition("/src/stadimeter/")[2]: path for path in self._data.measured_files()}
        self._seconds = seconds

    def tests(self, path: str, line: int) -> list[str]:
        """Return the tests of a line; for one that is run by importing the file, of any line of the file."""
        lines = self._data.contexts_by_lineno(self._files[path]) if path in self._files else {}
        names = set(lines.get(line, ())) - {""} or {name for each in lines.values() for name in each} - {""}
        return sorted({name.partition("|")[0] for name in names}, key=lambda name: self._seconds.get(name, 1e9))


def is_killed(root: Path, tests: list[str]) -> str:
    """Return the test that fails, or an empty string."""
    of_file: dict[str, list[str]] = defaultdict(list)
    for test in tests:
        of_file[test.partition("::")[0]].append(test)
    (root / "chosen.json").write_text(json.dumps(tests))
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "benchmarks.chosen", *of_file]
    environment = {**os.environ, "PYTHONPATH": f"{root / 'src'}:tests", "CHOSEN": str(root / "chosen.json")}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=SECONDS + 60
        )
    except subprocess.TimeoutExpired:
        return "time"
    failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return failed[0] if failed else "" if done.returncode in {0, 5} else "collection"


def judge(root: Path, coverage: Coverage, path: str, number: int, known: str) -> dict[str, Any]:
    """Return what became of one mutant."""
    file = root / "src/stadimeter" / path
    text = file.read_text(encoding="utf-8")
    wrong, line, name = mutated(text, number)
    tests = coverage.tests(path, line)
    killer = ""
    try:
        file.write_text(wrong, encoding="utf-8")
        for chosen in ([known] if known else [], tests[:FIRST], tests[FIRST : FIRST + MORE]):
            killer = killer or (is_killed(root, chosen) if chosen else "")
    finally:
        file.write_text(text, encoding="utf-8")
    return {"path": path, "number": number, "line": line, "mistake": name, "tests": len(tests), "killer": killer}


def main() -> None:
    """Judge a sample of mutants, and print how many were killed of each part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--coverage", type=Path, default=Path(".coverage"))
    parser.add_argument("--durations", type=Path, help="JSON: seconds of each test; quick ones are run first")
    parser.add_argument("--before", type=Path, help="what an earlier call wrote: the test that killed is tried first")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    seconds = json.loads(options.durations.read_text()) if options.durations else {}
    before = json.loads(options.before.read_text()) if options.before else []
    known = {(each["path"], each["number"]): each["killer"] for each in before}
    coverage = Coverage(options.coverage, seconds)
    roots: Queue[Path] = Queue()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.jobs) as pool:
        for job in range(options.jobs):
            shutil.copytree("src", Path(folder) / str(job) / "src")
            roots.put(Path(folder) / str(job))

        def one(place: tuple[str, int]) -> dict[str, Any]:
            root = roots.get()
            try:
                return judge(root, coverage, *place, known.get(place, ""))
            finally:
                roots.put(root)

        results = []
        for result in pool.map(one, sample(Path("src/stadimeter"), options.count, options.seed)):
            results.append(result)
            options.output.write_text(json.dumps(results, indent=1))
    made = Counter(each["path"].partition("/")[0] for each in results)
    killed = Counter(each["path"].partition("/")[0] for each in results if each["killer"])
    for part, count in sorted(made.items()):
        print(f"{part}: {killed[part]} of {count} killed")
    print(f"all: {sum(killed.values())} of {len(results)} killed")


if __name__ == "__main__":
    main()
