"""Messengers: alerts and states for other programs. The interface is in `stadimeter.messaging.protocol`."""
