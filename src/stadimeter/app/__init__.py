"""The shell: reads the clock, moves frames, commands and messages between drivers and the core."""
