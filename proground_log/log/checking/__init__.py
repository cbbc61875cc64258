"""What is wrong with a log: damage, gaps, and frames that contradict each other."""
