"""The life of an alarm: its phases, its timers, and what it does in each."""
