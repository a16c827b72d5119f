"""Live views of a run: one snapshot for the terminal and the page."""
