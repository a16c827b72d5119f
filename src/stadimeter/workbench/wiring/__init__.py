"""Wiring drawings: what hangs on which pin of the header, from a configuration."""
