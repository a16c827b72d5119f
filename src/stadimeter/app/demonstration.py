"""The configuration of the demonstration, wherever stadimeter is installed."""

from __future__ import annotations

from pathlib import Path

import stadimeter
from stadimeter.config.loader import Configuration, load_configuration


def demo_configuration() -> Configuration:
    """Load the demonstration's configuration: ``config/demo.toml`` of the checkout, or its copy in a package.

    Raises:
        ConfigError: It is damaged.
    """
    return load_configuration(Path(stadimeter.__file__).parent / "configurations" / "demo.toml")
