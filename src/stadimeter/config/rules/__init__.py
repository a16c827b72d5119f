"""The tables of rules, and what they may not say."""
