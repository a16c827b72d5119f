"""One value of a TOML text is changed, and everything else stays as it was written."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.toml_lines import set_value
from stadimeter.errors import ConfigError

TEXT = """# the door
[rules.near]   # sounds
when = { below = "1 m", target = "ball" }  # at the door
on_delay = "0 s"

[rules."far = away"]
when.above = "3 m"
any = [{ below = "1 m" }, { between = ["1 m", "2 m"] }]
"""
NEAR, FAR = ("rules", "near"), ("rules", "far = away")


@pytest.mark.parametrize(
    ("path", "was", "now"),
    [
        ((*NEAR, "when", "below"), 'below = "1 m", target', 'below = "2 m", target'),
        ((*NEAR, "on_delay"), 'on_delay = "0 s"', 'on_delay = "2 m"'),
        ((*NEAR, "when", "deadband"), 'target = "ball" }  #', 'target = "ball", deadband = "2 m" }  #'),
        ((*NEAR, "off_delay"), "# sounds\n", '# sounds\noff_delay = "2 m"\n'),
        ((*FAR, "when", "above"), 'above = "3 m"', 'above = "2 m"'),
        ((*FAR, "when", "deadband"), 'away"]\n', 'away"]\nwhen.deadband = "2 m"\n'),
        ((*FAR, "any", 1, "between", 0), '["1 m", "2 m"]', '["2 m", "2 m"]'),
        ((*FAR, "any", 0, "deadband"), '[{ below = "1 m" }', '[{ below = "1 m", deadband = "2 m" }'),
    ],
)
def test_the_value_alone_changes(path: tuple[str | int, ...], was: str, now: str) -> None:
    assert set_value(TEXT, path, '"2 m"') == TEXT.replace(was, now, 1)


def test_a_form_that_cannot_be_changed_is_refused_with_what_to_write() -> None:
    text = '[rules.near]\nbetween = [\n  "1 m",\n  "2 m",\n]\n'
    with pytest.raises(ConfigError, match="by hand"):
        set_value(text, ("rules", "near", "between"), '"2 m"')


NAMES = st.sampled_from(["a", "b c", 'd"e', "f=g", "ä"])


@given(st.recursive(st.integers(0, 9), lambda inner: st.dictionaries(NAMES, inner, max_size=3), max_leaves=8), NAMES)
def test_whatever_is_written_means_what_was_meant_or_is_refused(table: object, name: str) -> None:
    def written(value: object) -> str:
        if not isinstance(value, dict):
            return str(value)
        quoted = (f'"{key}"'.replace('d"e', 'd\\"e') + f" = {written(each)}" for key, each in value.items())
        return "{ " + ", ".join(quoted) + " }"

    text = f"[t]\nx = {written(table)}\n"
    try:
        changed = set_value(text, ("t", "x", name), "77")
    except ConfigError:
        return
    assert tomllib.loads(changed)["t"]["x"][name] == 77
