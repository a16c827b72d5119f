"""The page: a process of its own that shows a run, sets it up and operates it, and computes nothing itself."""
