"""Cameras: where frames come from. The interface is in `stadimeter.cameras.protocol`, each driver in its own file."""
