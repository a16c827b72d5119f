"""The command line as a whole: what it lists, and what it loads for that."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from stadimeter.cli.main import PANELS, STILL, app, place_of
from stadimeter.config import plugins

HEAVY = ("cv2", "numpy", "pydantic", "paho", "gpiozero", "serial", "stadimeter.app", "stadimeter.config")
OF_DRIVERS = ("paho", "gpiozero", "serial", "lgpio", "stadimeter.simulation", "stadimeter.messaging.mqtt")


def done_by(code):
    """Return what came of some code in a fresh Python."""
    return subprocess.run(
        [sys.executable, "-c", f"import json, sys\n{code}"], capture_output=True, text=True, check=True
    )


@cache
def loaded_by(code):
    """Return which modules a fresh Python has after running some code."""
    done = done_by(f"{code}\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)")
    return json.loads(done.stderr.splitlines()[-1])


def among(modules, names):
    return [module for module in modules if any(module == name or module.startswith(f"{name}.") for name in names)]


def test_the_command_line_loads_nothing_that_only_commands_need():
    assert among(loaded_by("import stadimeter.cli.main"), HEAVY) == []


def test_the_help_loads_no_command():
    code = "from stadimeter.cli.main import app\ntry:\n    app(['--help'])\nexcept SystemExit:\n    pass"
    assert among(loaded_by(code), HEAVY) == []


@pytest.mark.long
def test_no_command_loads_a_driver_that_nobody_named():
    """One after the other in one process, so that the first that loads a driver is named."""
    modules = sorted({place_of(name)[0] for commands in PANELS.values() for name in commands})
    code = f"""
from importlib import import_module
loaders = {{}}
for name in {modules!r}:
    before = set(sys.modules)
    import_module(name)
    loaders[name] = sorted(set(sys.modules) - before)
print(json.dumps(loaders))"""
    loaders = json.loads(done_by(code).stdout)
    assert list(loaders) == modules
    assert {name: among(loaded, OF_DRIVERS) for name, loaded in loaders.items() if among(loaded, OF_DRIVERS)} == {}


@pytest.mark.long
def test_a_run_loads_no_warnings_no_rule_tests_and_no_descriptions(tmp_path):
    config = Path(__file__).parents[2] / "config" / "demo.toml"
    arguments = ["run", str(config), "--frames", "2", "--speed", "0", "--state", str(tmp_path / "state")]
    code = f"from stadimeter.cli.main import app\ntry:\n    app({arguments!r})\nexcept SystemExit:\n    pass"
    loaded = loaded_by(code)
    assert among(loaded, ["stadimeter.config.loader"])
    only_for_check = ("warnings", "rule_test_tables", "rule_test_checks", "describe", "schema")
    assert among(loaded, [f"stadimeter.config.{name}" for name in only_for_check]) == []
    assert among(loaded, ["stadimeter.app.feasibility", "stadimeter.workbench"]) == []


@pytest.mark.long
def test_a_run_loads_nothing_that_only_other_views_and_commands_need():
    unused = ["rich", "asyncio", "mcap", "stadimeter.workbench", "stadimeter.app.recordings", "stadimeter.app.control"]
    assert among(loaded_by("import stadimeter.cli.run"), unused) == []


def test_the_doctor_begins_without_the_libraries_that_may_be_broken():
    assert among(loaded_by("import stadimeter.cli.doctor"), ["cv2", "numpy", "pydantic", "simplejpeg"]) == []


def test_built_in_drivers_are_found_without_reading_the_record_of_every_installed_package(monkeypatch):
    monkeypatch.setattr(plugins, "installed", lambda group: pytest.fail(f"looked for {group} everywhere"))
    assert plugins.load_driver(plugins.CAMERAS, "images").model_fields
    assert plugins.load_driver(plugins.DETECTORS, "ball").model_fields


LISTED = [name for commands in PANELS.values() for name in commands]


def test_the_list_of_commands_says_what_the_command_says_itself():
    for name in LISTED:
        group = typer.main.get_command(app)
        summary = group.commands[name].help
        own = " ".join(group.load(name).help.split("\n\n")[0].split())
        assert own == summary


def test_the_help_lists_what_is_needed_first_on_one_screen_and_with_all_every_command_in_groups():
    for words in [[], ["--help"]]:
        shown = CliRunner().invoke(app, words).output
        assert [name for name in LISTED if f"\n  {name} " in shown] == [*PANELS["Start here"]]
        assert "stadimeter help --all" in shown
        assert len(shown.splitlines()) <= 24
        assert max(map(len, shown.splitlines())) <= 80
    shown = CliRunner().invoke(app, ["help", "--all"]).output
    assert [name for name in LISTED if f"│ {name} " in shown] == LISTED
    assert [heading for heading in PANELS if f"─ {heading} ─" in shown] == [*PANELS]


def test_what_stops_goes_on_under_its_old_name(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name, words in STILL.items():
        done, new = CliRunner().invoke(app, [name]), CliRunner().invoke(app, [*words])
        assert done.output == f"note: say `stadimeter {' '.join(words)}` in place of `{name}`\n{new.output}"
        assert done.exit_code == new.exit_code == 2


def test_help_prints_what_the_option_prints():
    for words in [[], ["calibrate", "distance"]]:
        asked = CliRunner().invoke(app, ["help", *words])
        assert asked.exit_code == 0
        assert asked.output.strip() == CliRunner().invoke(app, [*words, "--help"]).output.strip()


def test_help_on_a_command_that_is_none_says_so():
    for words in [["nothing"], ["calibrate", "nothing"], ["measure", "nothing"]]:
        asked = CliRunner().invoke(app, ["help", *words])
        assert asked.exit_code == 2
        assert "o such command" in asked.output or "there is no command" in asked.output


COMPLETED = {
    "stadimeter cal": "calibrate",
    "stadimeter alarm sh": "shelve",
    "stadimeter alarm ack fo": "follow",
    "stadimeter outputs st": "stop",
    "stadimeter site certify --target b": "ball",
    "stadimeter explain --config demo.toml ne": "near",
    "stadimeter check de": "",  # a shell completes names of files itself
}


@pytest.mark.long
@pytest.mark.parametrize("line", COMPLETED)
def test_a_shell_completes_commands_rules_and_targets_without_another_word(line, tmp_path):
    config = Path(__file__).parents[2] / "config"
    words = {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" ")), "_STADIMETER_COMPLETE": "complete_bash"}
    environ = {**os.environ, **words, "XDG_RUNTIME_DIR": str(tmp_path)}
    command = [Path(sys.executable).with_name("stadimeter")]
    done = subprocess.run(command, env=environ, cwd=config, capture_output=True, text=True, check=False)
    assert done.stdout.split() == COMPLETED[line].split()
    assert done.stderr == ""


def test_an_unknown_command_is_told_with_the_nearest_one():
    result = CliRunner().invoke(app, ["meaure"])
    assert result.exit_code == 2
    assert "Did you mean 'measure'?" in result.output
