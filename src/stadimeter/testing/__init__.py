"""For people who write drivers and rules: a clock to move by hand, contract suites."""
