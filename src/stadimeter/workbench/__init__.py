"""Work at a desk: replays, rule tests, tuning, calibration, measuring pictures, doctor. Never loaded by `run`."""
