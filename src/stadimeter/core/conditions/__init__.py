"""The judging of conditions, given how sure the figures are that they are judged by."""
