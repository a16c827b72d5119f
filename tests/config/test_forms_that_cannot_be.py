"""Contradictory, unreachable and endless forms of every kind of condition: `check` finds each at its line.

A line that is wrong says so itself: ``# error CODE`` or ``# warning CODE``. Nothing else may be found.
"""

import re

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError

AROUND = """
[camera]
driver = "simulated"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[world]
[base]
driver = "simulated"
[messenger]
driver = "simulated"
[actuators.motor]
driver = "simulated"
[targets.ball]
detector = "ideal"
[targets.tag]
detector = "ideal"
[figures.nearest]
target = "ball"
statistic = "minimum"
within = "1 h"
[rules.near]
target = "ball"
when = { below = "1 m" }
[rules.far]
target = "ball"
when = { above = "3 m" }
[rules.each]
targets = ["ball", "tag"]
when = { below = "1 m" }
[rules.report]
every = "1 min"
target = "ball"
escalation = [{ topic = "a", text = "b" }]
"""
BERLIN = "[place]\nlatitude = 52.5\nlongitude = 13.4\ntime_zone = 'Europe/Berlin'\n"
RAMP = '[rules.x]\ntarget = "ball"\nactuator = "motor"\nramp = { from = "2 m", to = "1 m" }\n'
STEP = '[rules.x]\ntarget = "ball"\nwhen = { below = "1 m" }\n[[rules.x.escalation]]\ntopic = "a"\ntext = "b"\n'
SAID = re.compile(r"# (error|warning) ([a-z-]+)$")

# A condition of an alarm on the ball, and what is found of it.
CONDITIONS = {
    # Counts and sums of what other rules did.
    'count = { rule = "near", at_least = 2, since = "25:00" }': "error bad-value",
    'count = { rule = "x", at_least = 2, within = "1 h" }': "error reference-cycle",
    # Figures.
    'figure = { name = "nearest" }': "error bad-value",
    'figure = { name = "nearest", below = "1 m", above = "2 m" }': "error bad-value",
    # Two targets compared.
    'nearer_than = "tga"': "error unknown-name",
    'left_of = { target = "tag", by = "1 m" }': "error bad-value",
    # Quantities.
    'place = { axis = "height", above = "2 m" }': "error height-unknown",
    'size = { above = "2000 %" }': "error bad-value",
    # The order of rules.
    'sequence_of = { rules = ["near", "near"], within = "2 s" }': "error bad-value",
    'sequence_of = { rules = ["near", "each"], within = "2 s" }': "error unknown-name",
    'sequence_of = { rules = ["near", "far"], within = "0 s" }': "error bad-value",
    'sequence_of = { rules = ["near", "x"], within = "2 s" }': "error reference-cycle",
    # Schedules.
    'time = { between = ["12:00", "12:00"] }': "error bad-value",
}  # fmt: skip

# Whole rules, places and figures.
OTHERS = {
    "two rules that count each other":
        '[rules.x]\nwhen = { count = { rule = "y", at_least = 2, within = "1 min" } }  # error reference-cycle\n'
        '[rules.y]\nwhen = { active_for = { rule = "x", at_least = "1 s", within = "1 min" } }\n',
    "a figure over two windows":
        '[figures.x]  # error bad-value\ntarget = "ball"\nstatistic = "mean"\nwithin = "1 s"\nsince = "06:00"\n',
    "a figure of an unknown height":
        '[figures.x]\ntarget = "ball"\nof = "height"  # error height-unknown\nstatistic = "mean"\nwithin = "1 s"\n',
    "a ramp whose gate asks for itself": f'{RAMP}when = {{ rule = "x" }}  # error reference-cycle\n',
    "a ramp from and to the same size":
        '[rules.x]\ntarget = "ball"\nactuator = "motor"\n'
        'ramp = { of = "size", from = "20 %", to = "20 %" }  # error bad-value\n',
    "a step that asks for its own rule": f'{STEP}when = {{ rule = "x" }}  # error reference-cycle\n',
    "messages every so often and at a time":
        '[rules.x]  # error bad-value\ntarget = "ball"\nevery = "1 min"\nat = "12:00"\n'
        'escalation = [{ topic = "a", text = "b" }]\n',
    "messages that would drive something":
        '[rules.x]  # error bad-value\ntarget = "ball"\nactuator = "motor"\nevery = "1 min"\n'
        'escalation = [{ topic = "a", text = "b" }]\n',
    "a night that never comes where the sun does not set":
        "[place]\nlatitude = 69.6\nlongitude = 19\n[rules.x]\n"
        "when = { time = { between = ['sunset', 'sunrise'], dates = ['06-10..07-01'] } }  # warning empty-days\n",
}  # fmt: skip
FORMS = {
    **{when: f'[rules.x]\ntarget = "ball"\nwhen = {{ {when} }}  # {said}\n' for when, said in CONDITIONS.items()},
    **OTHERS,
}


def found(folder, text):
    """Return what `check` finds in the rules, figures and the place of a configuration."""
    path = folder / "forms.toml"
    path.write_text(AROUND + (text if "[place]" in text else BERLIN + text))
    try:
        configuration = load_configuration(path)
    except ConfigError as error:
        problems = [("error", each) for each in error.problems]
    else:
        problems = [("warning", each) for each in configuration.warnings]
    return [(kind, each) for kind, each in problems if each.key.startswith(("rules", "figures", "place"))]


def lines_that_say(text):
    head = AROUND if "[place]" in text else AROUND + BERLIN
    lines = enumerate((head + text).splitlines(), start=1)
    return [(number, *said.groups()) for number, line in lines if (said := SAID.search(line))]


@pytest.mark.parametrize("form", FORMS)
def test_a_form_that_cannot_be_meant_is_found_at_its_line_with_a_remedy(tmp_path, form):
    problems = found(tmp_path, FORMS[form])
    assert [(each.line, kind, each.code) for kind, each in problems] == lines_that_say(FORMS[form])
    assert all(each.hint or each.code == "bad-value" for _, each in problems)


def test_what_is_around_the_forms_is_sound(tmp_path):
    assert found(tmp_path, "") == []
