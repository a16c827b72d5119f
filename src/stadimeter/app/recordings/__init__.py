"""The files that runs leave behind: journals, and MCAP files with pictures."""
