"""Many devices at one broker: their state as one picture, and figures of their alarms."""
