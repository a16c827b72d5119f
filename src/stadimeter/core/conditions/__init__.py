"""Whether conditions hold, given how sure the figures are that they are judged by."""
