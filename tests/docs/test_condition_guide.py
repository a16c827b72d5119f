"""The guide to conditions, followed word by word on a copy of the sources."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.simulated_run import SIMULATED_BALL

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(
    r"^```(\w+)\n(.*?)^```", (ROOT / "docs/writing-a-condition.md").read_text(), re.MULTILINE | re.DOTALL
)
CONFIGURATION = f"""{SIMULATED_BALL}
[world]

[rules.dim]
actuator = "motor"
when = {{ unsure = "5 cm" }}
"""


def apply(diff, folder):
    """Insert the lines of each hunk behind its line of context, which must be there exactly once."""
    name = re.search(r"^\+\+\+ b/(\S+)$", diff, re.MULTILINE)[1]
    text = (folder / name).read_text()
    for hunk in diff.split("@@\n")[1:]:
        context, *added = hunk.splitlines()
        assert text.count(f"\n{context[1:]}\n") == 1, context
        text = text.replace(f"\n{context[1:]}\n", "\n".join(["", context[1:], *(line[1:] for line in added), ""]))
    (folder / name).write_text(text)


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guide")
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for kind, block in BLOCKS:
        if kind == "diff":
            apply(block, folder)
        elif name := re.match(r"# (\S+\.py)\n", block):
            path = folder / name[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.partition("\n")[2])
    (folder / "dim.toml").write_text(CONFIGURATION)
    return folder


def run(sources, *arguments):
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=sources,
        env={**os.environ, "PYTHONPATH": str(sources / "src"), "COLUMNS": "200"},
    )


@pytest.mark.long
def test_the_condition_of_the_guide_passes_its_tests(sources):
    done = run(sources, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", ".", "tests/core/test_unsure.py")
    assert done.returncode == 0, done.stdout


@pytest.mark.long
def test_the_condition_of_the_guide_can_be_written_and_is_described(sources):
    done = run(sources, "-m", "stadimeter", "check", "dim.toml")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the standard deviation of `ball` is above 50 mm" in " ".join(done.stdout.split())


@pytest.mark.long
def test_the_condition_of_the_guide_is_in_the_schema_and_runs(sources):
    assert "unsure" in run(sources, "-m", "stadimeter", "check", "--schema").stdout
    done = run(sources, "-m", "stadimeter", "run", "dim.toml", "--frames", "5", "--speed", "0")
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_guide_touches_one_file_that_is_there_already():
    assert sum(kind == "diff" for kind, _ in BLOCKS) == 1
