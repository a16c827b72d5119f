"""Robot bases: the interface is in `stadimeter.bases.protocol`; each serial protocol is a pure codec of its own."""
