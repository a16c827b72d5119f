"""Gates as they are written: `when` beside `ramp` and `follow`, and in steps of an escalation."""

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.rule import ALWAYS
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

OUTPUTS = """
[world]
[targets.tag]
detector = "ideal"
[base]
driver = "simulated"
[messenger]
driver = "simulated"
[buttons.mute]
driver = "simulated"
press = "shelve"
rule = "beep"
shelve_for = "10 s"
[rules.beep]
target = "ball"
actuator = "motor"
ramp = { from = "2 m", to = "30 cm" }
"""
RAMP = "ramp = { from = '2 m', to = '1 m' }\n"
NEAR = '[rules.near]\ntarget = "ball"\nwhen = { below = "1 m" }\n'
FOLLOW = '[rules.follow]\ntarget = "ball"\nactuator = "base"\nfollow = { distance = "1 m" }\n'


@pytest.fixture
def load(tmp_path):
    def load(rules):
        path = tmp_path / "gates.toml"
        path.write_text(SIMULATED_BALL + OUTPUTS + rules)
        return load_configuration(path)

    return load


def test_when_beside_a_ramp_or_follow_is_its_gate(load):
    beep, follow = load(
        'when = { above = "1 m" }\nshelve_max = "1 h"\n'
        f'{FOLLOW}when = {{ target = "tag", seen = true }}\nsuppress_when = {{ lost = "1 s" }}\n'
    ).plan.rules
    gate = beep.gate
    assert isinstance(gate.condition, DistanceCondition)
    assert (gate.name, gate.condition.target, gate.shelve_max_s) == ("beep", "ball", 3600.0)
    assert follow.target == "ball"
    assert follow.gate.condition == PresenceCondition(seen=True, target="tag")
    assert follow.gate.suppress_when == PresenceCondition(seen=False, for_s=1.0, target="ball")


def test_without_one_a_rule_always_acts_and_can_be_shelved(load):
    (beep,) = load("").plan.rules
    assert (beep.gate.condition, beep.gate.shelve_max_s) == (ALWAYS, 8 * 3600.0)


@pytest.mark.parametrize(
    ("rules", "said"),
    [
        ("when = { seen = true }\nlatch = true\n", "'latch' has no meaning beside ramp"),
        (
            'severity = "safety"\nsuppress_when = { lost = true }\n',
            "a safety rule acts at once and always, so it has no suppress_when",
        ),
        (
            f"{NEAR}escalation = [{{ topic = 'a', text = 'x', when = {{ rule = 'naer' }} }}]\n",
            "rules.near.escalation.0.when.rule: there is no rule 'naer'",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_with_words(load, rules, said):
    with pytest.raises(ConfigError) as caught:
        load(rules)
    assert said in str(caught.value)
