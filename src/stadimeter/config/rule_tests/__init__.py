"""The tables of tests for rules."""
