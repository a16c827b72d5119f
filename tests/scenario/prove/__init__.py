"""A proof by exhaustive simulation: every sequence of a few faults, and whether the wheels stop."""
