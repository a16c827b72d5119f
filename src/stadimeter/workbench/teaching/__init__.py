"""Teaching an alarm by pointing: marks where it should have fired, and the smallest change that meets them."""
