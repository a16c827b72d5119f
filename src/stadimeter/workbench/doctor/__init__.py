"""Causes that keep stadimeter from working on a computer: pure checks over facts that one small reader reads."""
