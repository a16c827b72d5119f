"""What a device lets a fleet change, and what it takes from a configuration that lacks some sections."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError
from stadimeter.workbench.fleet import policy
from stadimeter.workbench.fleet.policy import MotionPermit, changed_motion, changed_settings, compose, load_policy
from support.simulated_run import SIMULATED_BALL

ROBOT = f"""{SIMULATED_BALL}
[base]
driver = "simulated"

[rules.near]
when = {{ below = "1 m" }}
actuator = "motor"

[rules.far]
when = {{ above = "3 m" }}

[rules.stay]
actuator = "base"
follow = {{ distance = "1 m" }}
priority = 5

[messenger]
driver = "simulated"
[world]
"""


BALL = SIMULATED_BALL + "[world]\n"
LEASE = "[lease of an output]"


def loaded(folder: Path, text: str) -> Configuration:
    path = folder / "a.toml"
    path.write_text(text)
    return load_configuration(path)


def test_sections_that_are_desired_replace_those_of_the_device_and_the_others_stay() -> None:
    rules = '# from git\n[rules.low]\nwhen = { below = "2 m" }\n[[tests]]\nname = "x"\n'
    text = compose(ROBOT, rules)
    assert tomllib.loads(text) == {**tomllib.loads(ROBOT), **tomllib.loads(rules)}
    assert text.startswith("# from git\n")
    assert compose(text, rules) == text


def test_a_desired_configuration_with_every_section_is_taken_as_it_is() -> None:
    whole = ROBOT + "# the end\n[web]\n"
    assert compose(ROBOT, whole) == whole


@pytest.mark.parametrize(
    "own",
    [
        'camera.driver = "simulated"\n',
        '[camera]\nname = """\n[rules.near]\n"""\n',
    ],
)
def test_a_file_whose_sections_cannot_be_separated_is_left_alone(own: str) -> None:
    with pytest.raises(ConfigError, match="cannot be separated"):
        compose(own, '[rules.near]\nwhen = { below = "2 m" }\n')


def test_what_is_no_toml_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(ConfigError, match="more than 64 deep"):
        compose(ROBOT, "a = " + "[" * 5000)
    with pytest.raises(ConfigError, match="not valid TOML"):
        compose(ROBOT, "[rules")


@pytest.mark.parametrize(
    ("old", "new", "settings", "motion"),
    [
        ('below = "1 m"', 'below = "2 m"', (), ()),
        ('above = "3 m"', 'above = "4 m"', (), ()),
        ('distance = "1 m"', 'distance = "2 m"', (), ("rule 'stay'",)),
        ('actuator = "motor"', 'actuator = "base"\nlevel = 0.0', (), ("rule 'near'",)),
        ('[rules.stay]\nactuator = "base"\nfollow = { distance = "1 m" }\npriority = 5\n', "", (), ("rule 'stay'",)),
        ('[messenger]\ndriver = "simulated"', "", ("[messenger]",), ()),
        ("[world]", "[web]\nport = 8081\n[world]", ("[web]",), ()),
        ("[world]", '[safety]\nmax_frame_age = "1 s"\n[world]', ("[safety]",), ("[safety]",)),
        ("[world]", '[tracking]\ncoast = "1 s"\n[world]', ("[tracking]",), ("[tracking]",)),
        ('[base]\n', '[base]\nmax_speed = "2 m/s"\n', ("[actuators or base]",), ("[actuators or base]",)),
        ("fx_px = 600.0", "fx_px = 900.0", ("[camera.model]",), ("[camera.model]",)),
        ("[actuators.motor]\n", '[actuators.motor]\nlease = "200 ms"\n', (LEASE,), (LEASE,)),
    ],
)  # fmt: skip
def test_what_may_move_something_otherwise_is_named(
    tmp_path: Path, old: str, new: str, settings: tuple[str, ...], motion: tuple[str, ...]
) -> None:
    assert old in ROBOT
    if 'actuator = "base"\nlevel' in new:  # an alarm that holds the base
        new = 'actuator = "base"'
    before, after = loaded(tmp_path, ROBOT), loaded(tmp_path, ROBOT.replace(old, new, 1))
    assert (changed_settings(before, after), changed_motion(before, after)) == (settings, motion)


def test_without_a_base_only_outputs_and_what_stops_them_count_as_motion(tmp_path: Path) -> None:
    before = loaded(tmp_path, BALL)
    lens = loaded(tmp_path, BALL.replace("fx_px = 600.0", "fx_px = 900.0"))
    level = loaded(tmp_path, BALL.replace("[world]", "safe = 0.5\n[world]"))
    assert (changed_settings(before, lens), changed_motion(before, lens)) == (("[camera.model]",), ())
    assert changed_motion(before, level) == ("[actuators or base]",)


def test_a_rule_on_which_a_moving_rule_depends_counts_as_motion(tmp_path: Path) -> None:
    held = ROBOT.replace(
        '[rules.far]\nwhen = { above = "3 m" }',
        '[rules.far]\nactuator = "base"\nwhen = { all = [{ above = "3 m" }, { rule = "near" }] }',
    )
    before, after = loaded(tmp_path, held), loaded(tmp_path, held.replace('below = "1 m"', 'below = "2 m"'))
    assert changed_motion(before, after) == ("rule 'near'",)


def test_a_policy_is_read_with_paths_from_its_own_folder(tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text('allowed_signers = "signers"\nstate = "state"\n')
    found = load_policy(file)
    assert (found.allowed_signers, found.change, found.replay) == (tmp_path / "signers", "rules", "if-recorded")
    assert found.file_beside(Path("/etc/a.toml"), "json") == tmp_path / "state" / "a.fleet-json"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "allowed_signers"),
        ('allowed_signers = "a"\nchange = "some"', "change"),
        ('allowed_signers = "a"\nmotion = true', "motion"),
        ("allowed_signers = [", "not valid TOML"),
    ],
)
def test_a_policy_that_is_wrong_is_an_error_with_its_key(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_policy(file)
    with pytest.raises(ConfigError, match="at least whom to believe"):
        load_policy(tmp_path / "none.toml")


def test_motion_may_be_changed_once_within_a_time_since_the_boot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(policy, "_since_boot_s", lambda: now_s)
    permit = MotionPermit(tmp_path / "permit")
    assert not permit.stands()
    permit.use()
    permit.give(60.0)
    assert permit.stands()
    now_s = 1061.0
    assert not permit.stands()
    permit.give(60.0)
    monkeypatch.setattr(policy, "_boot_id", lambda: "another boot")
    assert not permit.stands()
    permit.give(60.0)
    permit.use()
    assert not permit.stands()
    (tmp_path / "permit").write_bytes(os.urandom(100))
    assert not permit.stands()
