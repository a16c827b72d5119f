"""The memory of alarms beyond the end of a run."""
