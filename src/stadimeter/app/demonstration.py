"""The configuration of the demonstration, wherever stadimeter is installed."""

from __future__ import annotations

from pathlib import Path

import stadimeter
from stadimeter.config.loader import Configuration, load_configuration


def demo_configuration() -> Configuration:
    """Load the demonstration's configuration.

    Returns:
        The configuration ``config/demo.toml`` of the checkout, or its copy in an installed package.

    Raises:
        ConfigError: It is damaged.
    """
    package = Path(stadimeter.__file__).parent
    installed = package / "configurations" / "demo.toml"
    return load_configuration(installed if installed.exists() else package.parents[1] / "config" / "demo.toml")
