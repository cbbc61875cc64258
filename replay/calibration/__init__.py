"""What each stage of a replay takes on this machine: a cost model."""
