"""Work at a desk: replays, rule tests, tuning, calibration, measuring pictures, benchmarks. Never loaded by `run`."""
