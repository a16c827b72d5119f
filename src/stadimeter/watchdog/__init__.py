"""The watchdog process, and what it holds: what makes every output safe from outside, when the program is gone.

The process is tiny and starts first. It runs as ``python -I -S …/watchdog/__main__.py``, so nothing of an environment
is loaded: this package uses the standard library only, and little of that, for each module costs memory.
`deploy/safe-outputs` and the command ``safe`` do the same by the same code.
"""
