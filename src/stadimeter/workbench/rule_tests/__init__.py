"""Tests that a configuration carries for its rules."""
