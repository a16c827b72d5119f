"""Run the command line as ``python -m stadimeter``."""

from stadimeter.cli import main

main()
