"""A detector that is made up of the ground truth, with a detector's errors."""
