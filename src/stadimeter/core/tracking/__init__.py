"""From measurements to tracks: the filter and the life cycle of a target."""
