"""Targets and boards to print at true scale."""
