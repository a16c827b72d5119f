"""From a frame and the tracks to measurements."""
