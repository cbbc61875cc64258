"""What a run is on disk: settings, manifest, ledger, checkpoints."""
