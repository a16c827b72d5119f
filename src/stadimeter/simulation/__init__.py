"""A simulated world, and drivers that live in it. They behave, and have knobs for faults."""
