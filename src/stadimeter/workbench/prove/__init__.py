"""Proof by exhaustive simulation: every sequence of a few faults, against the emulated base."""
