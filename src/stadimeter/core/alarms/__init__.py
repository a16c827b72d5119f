"""The life of an alarm: its states, its timers, and what it does in each."""
