"""Says in plain sentences what a configuration does."""
