"""Conditions, one class a kind; `leaf.Leaf` says what a kind answers, and `holds` is its verdict.

A threshold is compared with a figure in `limits.LimitsCondition.is_within`, and that of a distance, for speed, in
`distance.DistanceCondition`. How likely a figure is below a threshold is worked out in `evidence`.
"""
