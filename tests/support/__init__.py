"""The project's own rigs: scenes with exact truth, a broker, a tunnel, listeners, journals."""
