"""What an operator may set a threshold to is what the configuration takes there, and nothing else."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.loader import load_configuration
from stadimeter.core.alarms.machine import thresholds_of
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

# A condition with a gap for the value, the name of its threshold, its unit, and a value that is taken.
FORMS = [
    ('{{ below = "{} m" }}', "below", 0.5),
    ('{{ above = "{} m", deadband = "20 cm" }}', "above", 0.5),
    ('{{ between = ["{} m", "2 m"] }}', "between.near", 0.5),
    ('{{ between = ["1 m", "{} m"] }}', "between.far", 2.0),
    ('{{ above = "{} m", below = "2 m" }}', "between.near", 0.5),
    ('{{ bearing = {{ above = "{} rad" }} }}', "bearing.above", 0.1),
    ('{{ elevation = {{ between = ["-0.1 rad", "{} rad"] }} }}', "elevation.between.high", 0.5),
    ('{{ closing_speed = {{ above = "{} m/s" }} }}', "closing_speed.above", 0.5),
    ('{{ closing_speed = {{ between = ["{} m/s", "2 m/s"] }} }}', "closing_speed.between.low", 0.5),
    ('{{ time_to_contact = {{ below = "{} s" }} }}', "time_to_contact.below", 0.5),
    ('{{ lost = "{} s" }}', "lost", 3.0),
    ('{{ seen = "{} s" }}', "seen", 3.0),
]
EDGES = [0.0, -0.0, 0.2, 1.0, 2.0, 1e-13, 1e-12, 1e9, 1e10, 3.2e9, 1e6, 1e4, -1e4, 2e4, math.pi]
values = st.sampled_from([*EDGES, *(math.nextafter(each, math.inf) for each in EDGES)]) | st.floats(-2e10, 2e10)


def load(folder, when):
    file = folder / "door.toml"
    file.write_text(f"{SIMULATED_BALL}\n[rules.near]\nwhen = {when}\n[world]\n")
    return load_configuration(file)


def load_or_refuse(folder, when):
    try:
        return load(folder, when).plan.rules[0]
    except ConfigError:
        return None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bounds")


@pytest.mark.long
@given(form=st.sampled_from(FORMS), value=values | st.floats(0.05, 3.0))
def test_an_operator_may_set_what_the_configuration_takes_and_nothing_else(folder, form, value):
    when, key, sound = form
    (rule,) = load(folder, when.format(sound)).plan.rules
    is_taken = thresholds_of(rule)[key].takes(value)
    if key in {"lost", "seen"} and value == 0:  # another condition: without a time
        assert not is_taken
        return
    written = load_or_refuse(folder, when.format(f"{value:.17g}"))
    assert (written is not None) is is_taken
    if written is not None:
        assert thresholds_of(written)[key].value == value
