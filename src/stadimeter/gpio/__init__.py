"""GPIO pins, for the drivers of actuators, buttons and bases alike."""
