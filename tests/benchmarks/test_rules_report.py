"""The report of rules says which goals are met."""


def test_a_report_says_which_goals_are_met():
    import rules_report
    from part import Part

    facts = {"leap late 10 Hz": 0.1, "leap late 15 Hz": 0.1, "rules late 2 m": 0.3, "rules late 8 m": 0.1}
    text = rules_report.report([Part(title="Rules on noise", text="…", facts=facts)])
    lines = {line.split(" | ")[0]: line for line in text.splitlines() if line.startswith("| ")}
    assert lines["| a leap, 10 / 15 frames a second: how late"].endswith("| 0.100 s / 0.100 s | yes |")
    assert lines["| coming at 2 m/s: how late, on average"].endswith("| 0.300 s / 0.100 s | **no** |")
    assert "not measured" in text
