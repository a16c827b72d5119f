"""Proposing limits and delays of an alarm from recordings."""
