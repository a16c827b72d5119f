"""A configuration in plain sentences."""
