"""What the documentation shows is so: configurations, commands, links, promises and symptoms."""

from __future__ import annotations

import itertools
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

from stadimeter.cli.main import app
from stadimeter.config.camera_file import stereo_file_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.errors import ConfigError
from stadimeter.ranging.measure import measure
from stadimeter.ranging.similar_triangles import expect
from support.fragments import completed
from support.two_cameras import BESIDE

# What the documentation shows, works: every configuration loads, every command exists, every link leads somewhere.

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "deploy").glob("*.md")),
]
ANSWERS = re.compile(r"^<!-- answers -->\n```toml\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
WRONG = re.compile(r"^<!-- wrong on purpose -->\n(?:<!-- .*? -->\n)?```\w+\n.*?^```\n", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`]*)`")
IN_A_SENTENCE = re.compile(r"(?:[a-z ]+ )?stadimeter ([a-z].*)", re.DOTALL)
LINK = re.compile(r"\]\(([^)#]+?)(?:#[^)]*)?\)")


def blocks(language):
    """Return the blocks of all pages that are written in a language, by the page and their number there."""
    return {
        f"{page.relative_to(ROOT)}-{number}": text
        for page in PAGES
        for number, (kind, text) in enumerate(FENCE.findall(ANSWERS.sub("", WRONG.sub("", page.read_text()))))
        if kind == language
    }


def is_configuration(text):
    return "entry-points" not in text and "kernel-led" not in text


@pytest.mark.long
def test_every_configuration_that_is_shown_can_be_loaded(tmp_path):
    path = tmp_path / "shown.toml"
    (tmp_path / "stereo.toml").write_text(stereo_file_text(BESIDE))
    failures = {}
    for block, text in blocks("toml").items():
        path.write_text(completed(text))
        try:
            first_target = load_configuration(path).plan.targets[0] if is_configuration(text) else "ball"
        except ConfigError as error:
            failures[block] = str(error)
        else:
            if first_target != "ball":
                failures[block] = f"its first target is {first_target}"
    assert failures == {}


def lines_typed(text):
    """Return the lines that a reader types, of each block of a page for a shell."""
    for kind, block in FENCE.findall(text):
        if kind == "sh":
            yield from block.splitlines()
        elif kind == "console":
            yield from (re.split(r" [|>] ", line[2:])[0] for line in block.splitlines() if line.startswith("$ "))


def commands():
    """Yield every command in a block or in a sentence: where it stands, and the words behind `stadimeter`."""
    for page in PAGES:
        text = page.read_text()
        typed = [shlex.split(line, comments=True) for line in lines_typed(text)]
        typed = [list(itertools.dropwhile(lambda word: word in {"uvx", "pipx", "run", "sudo"}, each)) for each in typed]
        for words in (each for each in typed if each and each[0].rpartition("/")[2] == "stadimeter"):
            yield page.name, words[1:]
        for span in CODE.findall(FENCE.sub("", text)):
            if shown := IN_A_SENTENCE.fullmatch(span):
                yield page.name, shlex.split(shown[1])


@pytest.mark.long
def test_every_command_that_is_shown_exists_with_its_options():
    unknown = [(page, words) for page, words in commands() if not exists_with_its_options(words)]
    assert unknown == []


def exists_with_its_options(words):
    command = typer.main.get_command(app)
    while hasattr(command, "commands") and words:
        if words[0] not in command.commands and getattr(command, "default", None) is not None:
            words = [command.default, *words]
        name, *words = words
        if name not in command.commands:
            return False
        command = command.load(name) if hasattr(command, "load") else command.commands[name]
    known = {option for parameter in command.params for option in parameter.opts}
    return {word.partition("=")[0] for word in words if word.startswith("-")} <= known


def test_the_first_commands_of_the_readme_need_nothing_but_the_source():
    (first, *_) = [block for kind, block in FENCE.findall((ROOT / "README.md").read_text()) if kind == "sh"]
    assert [line.partition("#")[0].split() for line in first.splitlines()] == [["make", "demo"], ["make", "test"]]


def test_every_link_leads_to_something_that_is_there():
    links = [(page, target) for page in PAGES for target in LINK.findall(page.read_text()) if "://" not in target]
    assert [f"{page}: {target}" for page, target in links if not (page.parent / target).exists()] == []


def anchors(page):
    """Return what links may name in a page: its headings, written as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_into_a_page_names_one_of_its_headings():
    for page in PAGES:
        for target, heading in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", page.read_text()):
            assert heading in anchors(page.parent / target if target else page), f"{page}: {target}#{heading}"


def test_make_targets_that_are_named_exist():
    targets = set(re.findall(r"^([a-z0-9.-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        for target in re.findall(r"(?:^|`)make ([a-z][a-z0-9.-]*[a-z0-9])", page.read_text(), re.MULTILINE):
            assert target in targets, f"{page.name}: make {target}"


GUIDE = (ROOT / "docs" / "writing-a-driver.md").read_text()
GUIDE_FILES = {
    name: code
    for _, code in FENCE.findall(GUIDE)
    for name in re.findall(r"\A# (\S+\.(?:py|toml))$", code, re.MULTILINE)
}
DRIVERS = ROOT / "docs" / "drivers"
GUIDE_FILES |= {str(file.relative_to(DRIVERS)): file.read_text() for file in sorted(DRIVERS.rglob("*.py"))}


@pytest.fixture
def driver_package(tmp_path):
    """Write the files of the guide, as a stranger would, and a record of its entry points, as pip does."""
    for name, code in GUIDE_FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(code)
    (tmp_path / "my_package" / "__init__.py").touch()
    record = tmp_path / "my_package-0.1.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 0.1\n")
    groups = tomllib.loads(GUIDE_FILES["pyproject.toml"])["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {at}\n" for name, at in each.items()) for group, each in groups.items()
    ]
    (record / "entry_points.txt").write_text("\n".join(lines))
    return tmp_path


def python_in(folder, *arguments):
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )


@pytest.mark.long
def test_the_drivers_of_the_guide_pass_their_contract_suites(driver_package):
    tests = ["tests/test_kernel_led.py", "tests/test_line_bot.py", "tests/test_lamp.py"]
    done = python_in(driver_package, "-m", "pytest", "-v", "-p", "no:cacheprovider", "--rootdir", ".", *tests)
    assert done.returncode == 0, done.stdout
    assert [test for test in tests if not re.search(rf"^{test}::.* PASSED", done.stdout, re.MULTILINE)] == []


@pytest.mark.long
def test_the_drivers_of_the_guide_are_found_by_their_entry_points(driver_package):
    (driver_package / "config.toml").write_text(
        '[actuators.lamp]\ndriver = "kernel-led"\nbrightness_file = "x"\nbright = 3\n'
        '[base]\ndriver = "line-bot"\nport = "/dev/ttyUSB0"\nmax_sped = "1 m/s"\n'
    )
    done = python_in(driver_package, "-m", "stadimeter", "check", "config.toml")
    assert "bright" in done.stdout + done.stderr
    assert "did you mean 'max_speed'" in done.stdout + done.stderr


LONG_LINES = 155


def test_a_long_page_begins_with_a_table_of_its_contents():
    for page in (page for page in PAGES if page.parent == ROOT / "docs"):
        text = page.read_text()
        start, *sections = re.split(r"^## ", FENCE.sub("", text), flags=re.MULTILINE)
        if len(text.splitlines()) <= LONG_LINES:
            continue
        linked = set(re.findall(r"\]\(#([^)]+)\)", start))
        names = {re.sub(r"[^\w\- ]", "", each.partition("\n")[0].lower()).replace(" ", "-") for each in sections}
        assert names - linked == set(), page


# What a page shows is run, or another test is named that does it.

TO_RUN = [page for page in PAGES if re.search(r"^```(?:sh|console)$", page.read_text(), re.MULTILINE)]
RUN_BY = re.compile(r"^<!-- run by: (\S+) -->\n```(?:sh|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", TO_RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_of_a_page_runs_and_prints_what_is_shown(page):
    command = [sys.executable, ROOT / "docs" / "make_output.py", page, "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_command_that_its_page_cannot_run_stands_in_the_test_that_is_named():
    named = [(page, test, block) for page in TO_RUN for test, block in RUN_BY.findall(page.read_text())]
    for page, test, block in named:
        text = (ROOT / test).read_text()
        calls = [each.split() for each in re.findall(r"stadimeter ([a-z].*)", block)]
        missing = [words[0] for words in calls if words[0] not in text]
        assert missing == [], f"{page.name}: {test}"


# The page on troubleshooting quotes what the program really says.

TROUBLE_PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
OF_OTHERS = {"numpy.dtype size changed", "stadimeter: command not found", "externally-managed-environment"}
"""What pip, Python and the shell say."""


def symptoms():
    """Return the messages in the first column: quoted, and of several words, to tell them from commands and names."""
    first = [line.split(" | ")[0] for line in TROUBLE_PAGE.splitlines() if line.startswith("| ")]
    quoted = [quote for cell in first for quote in re.findall(r"`([^`]+)`", cell)]
    return [quote for quote in quoted if " " in quote and "…" not in quote and not quote.startswith("stadimeter ")]


def test_every_message_that_is_quoted_stands_in_the_source():
    sources = (path.read_text() for path in (ROOT / "src" / "stadimeter").rglob("*.py"))
    unbroken = "\n".join(re.sub(r'"\s*\n\s*[rf]?"', "", source) for source in sources)
    quoted = set(symptoms()) - OF_OTHERS
    assert len(quoted) > 15
    assert sorted(quote for quote in quoted if quote not in unbroken) == []


# The shape that the page on target shapes makes, as a stranger would use it.

SHAPES_PAGE = Path(__file__).resolve().parents[2] / "docs" / "target-shapes.md"
SHAPES_CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


def pole(height_m: float) -> TargetShape:
    (code,) = re.findall(r"```python\n(.*?)```", SHAPES_PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict[str, type] = {}
    exec(compile(code, str(SHAPES_PAGE), "exec"), names)  # noqa: S102 - the page's own example
    made: TargetShape = names["Pole"](height_m=height_m)
    return made


def test_the_shape_of_the_page_is_measured_and_has_expectations():
    seen = Detection(
        target="pole",
        status=DetectionStatus.FOUND,
        centre_px=(SHAPES_CAMERA.cx_px, SHAPES_CAMERA.cy_px),
        width_px=12.0,
        height_px=300.0,
        size_sigma_px=0.3,
    )
    measured = measure(seen, pole(2.0), SHAPES_CAMERA, 0.0)
    assert measured.distance_m == pytest.approx(4.0)
    assert measured.sigma_m == pytest.approx(4.0 * 0.3 / 300)
    assert expect(pole(2.0), SHAPES_CAMERA, 4.0).size_px == pytest.approx(300.0)


def test_the_page_names_every_member_of_a_shape():
    members = {name for name in vars(TargetShape) if not name.startswith("_")}
    text = SHAPES_PAGE.read_text(encoding="utf-8")
    assert all(f"`{name}" in text for name in members)
