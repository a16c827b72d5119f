"""Configuration: from a TOML file that people write to a checked plan in SI units."""
