"""Range sensors: ultrasonic and time of flight, read beside the vision loop."""
