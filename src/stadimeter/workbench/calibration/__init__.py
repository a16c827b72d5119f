"""Calibration sessions: boards and known distances."""
