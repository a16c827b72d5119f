"""Actuators: vibration motors, buzzers, lamps. The interface is in `stadimeter.actuators.protocol`."""
