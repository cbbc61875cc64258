"""From a data set to a log."""
