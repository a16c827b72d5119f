"""What is wrong with rules though each by itself can be read: found before they run, by logic on their conditions."""
