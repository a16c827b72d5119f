"""The timeline of a run: what each second was like, kept for days."""
