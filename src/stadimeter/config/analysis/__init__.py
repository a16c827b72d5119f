"""Finds mistakes in rules that can each be read by themselves, before they run, by logic on their conditions."""
