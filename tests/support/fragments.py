"""Fragments of configurations, as the documentation shows them, put into whole ones."""

AROUND = {
    "camera": '[camera]\ndriver = "simulated"\n',
    "camera.model": "[camera.model]\nwidth_px = 640\nheight_px = 480\nfx_px = 600.0\nfy_px = 600.0\n"
    "cx_px = 319.5\ncy_px = 239.5\n",
    "targets.ball": '[targets.ball]\ndetector = "ideal"\n',
    "actuators.motor": '[actuators.motor]\ndriver = "simulated"\n',
    "actuators.buzzer": '[actuators.buzzer]\ndriver = "simulated"\n',
    "actuators.light": '[actuators.light]\ndriver = "simulated"\n',
    "base": '[base]\ndriver = "simulated"\n',
    "world": "[world]\n",
    "messenger": '[messenger]\ndriver = "simulated"\n',
    "notifiers.phone": '[notifiers.phone]\ndriver = "simulated"\n',
    "rules.near": '[rules.near]\nactuator = "buzzer"\nwhen = { below = "2 m" }\nack = "required"\n',
}
"""What a fragment of a configuration is put into."""


def completed(fragment):
    """Put a fragment of a configuration into a whole one, unless it brings that part itself."""
    if "[camera]" in fragment:
        return fragment
    brings_rules = "[rules." in fragment
    around = {name: table for name, table in AROUND.items() if not (brings_rules and name.startswith("rules."))}
    return "".join(table for name, table in around.items() if f"[{name}]" not in fragment) + fragment
