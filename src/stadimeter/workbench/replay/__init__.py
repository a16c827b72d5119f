"""Deciding again on what was recorded: replays, comparisons and explanations."""
