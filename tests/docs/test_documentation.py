"""What the documentation shows, works: every configuration loads, every command exists, every link leads somewhere."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "deploy").glob("*.md")),
]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#]+?)(?:#[^)]*)?\)")

AROUND = {
    "camera": '[camera]\ndriver = "simulated"\n',
    "camera.model": "[camera.model]\nwidth_px = 640\nheight_px = 480\nfx_px = 600.0\nfy_px = 600.0\n"
    "cx_px = 319.5\ncy_px = 239.5\n",
    "targets.ball": '[targets.ball]\ndetector = "ideal"\n',
    "actuators.motor": '[actuators.motor]\ndriver = "simulated"\n',
    "actuators.buzzer": '[actuators.buzzer]\ndriver = "simulated"\n',
    "base": '[base]\ndriver = "simulated"\n',
    "world": "[world]\n",
}
"""What a fragment of a configuration is put into."""


def blocks(language):
    return [
        pytest.param(page, text, id=f"{page.relative_to(ROOT)}-{number}")
        for page in PAGES
        for number, (kind, text) in enumerate(FENCE.findall(page.read_text()))
        if kind == language
    ]


def completed(fragment):
    """Put a fragment of a configuration into a whole one, unless it brings that part itself."""
    if "[camera]" in fragment:
        return fragment
    return "".join(table for name, table in AROUND.items() if f"[{name}]" not in fragment) + fragment


def is_configuration(text):
    return "entry-points" not in text and "kernel-led" not in text


@pytest.mark.parametrize(("page", "text"), [block for block in blocks("toml") if is_configuration(block.values[1])])
def test_every_configuration_that_is_shown_can_be_loaded(page, text, tmp_path):
    path = tmp_path / "shown.toml"
    path.write_text(completed(text))
    assert load_configuration(path).plan.targets == ("ball",)


def commands():
    for page in PAGES:
        for kind, text in FENCE.findall(page.read_text()):
            if kind != "sh":
                continue
            for line in text.splitlines():
                words = shlex.split(line, comments=True)
                if words and words[0].rpartition("/")[2] == "stadimeter":
                    yield pytest.param(words[1:], id=f"{page.name}: {' '.join(words)}")


@pytest.mark.parametrize("words", list(commands()))
def test_every_command_that_is_shown_exists_with_its_options(words):
    command = typer.main.get_command(app)
    while hasattr(command, "commands"):
        name, *words = words
        assert name in command.commands, f"there is no command {name}"
        command = command.load(name) if hasattr(command, "load") else command.commands[name]
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word.partition("=")[0] for word in words if word.startswith("-")} <= known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_something_that_is_there(page):
    for target in LINK.findall(page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_make_targets_that_are_named_exist():
    targets = set(re.findall(r"^([a-z0-9.-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        for target in re.findall(r"make ([a-z][a-z0-9.-]*[a-z0-9])", page.read_text()):
            if target not in {"sure", "it", "a"}:
                assert target in targets, f"{page.name}: make {target}"


def driver_example():
    text = (ROOT / "docs" / "writing-a-driver.md").read_text()
    return [code for kind, code in FENCE.findall(text) if kind == "python"]


def test_the_driver_of_the_guide_passes_the_contract_suite(tmp_path):
    """Run the guide's own files, as a stranger would."""
    import subprocess
    import sys

    package = tmp_path / "my_package"
    package.mkdir()
    (package / "__init__.py").touch()
    driver, test = driver_example()
    (package / "kernel_led.py").write_text(driver)
    (tmp_path / "test_kernel_led.py").write_text(test)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
