"""What a run shows to whoever watches it: one snapshot for the terminal and for the page."""
