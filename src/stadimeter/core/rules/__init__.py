"""Rules: conditions, alarms, ramps, following; who wins an output, and how fast it may change."""
