"""What alarms remember beyond the end of a run."""
