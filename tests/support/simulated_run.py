"""The beginning of a configuration for tests of whole runs: a simulated camera that sees a ball without drawing it."""

LENS = """
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
fy_px = 600.0
cx_px = 319.5
cy_px = 239.5
"""
"""About 56 degrees wide."""

SIMULATED_BALL = f"""
[camera]
driver = "simulated"
rate = "30 Hz"
render = false
{LENS}
[targets.ball]
detector = "ideal"

[actuators.motor]
driver = "simulated"
"""
"""Needs a ``[world]`` and rules to be whole."""
