"""A replay checked against a ledger while it runs: it stops at the first difference."""

from __future__ import annotations

import json
from collections.abc import Iterable

from proground_log.events import Event, RunFinished
from proground_log.run.ledger import entry_of
from replay.divergence.divergence import Divergence, Entry, LedgerComparison


class LedgerDivergedError(Exception):
    """The replay does not do what the ledger says.

    Args:
        divergence: the first difference; the ledger is its first, the replay its second.
    """

    def __init__(self, divergence: Divergence) -> None:
        super().__init__(divergence)
        self.divergence = divergence


class LedgerCheck:
    """A sink that compares each event with a ledger; raises `LedgerDivergedError` where it differs.

    Args:
        reference: the ledger's entries.
    """

    def __init__(self, reference: Iterable[Entry]) -> None:
        self._comparison = LedgerComparison(reference)

    def on_event(self, event: Event) -> None:
        """Compare the event with the ledger's next line."""
        entry = entry_of(event)
        divergence = None
        if isinstance(event, RunFinished):
            divergence = self._comparison.end()
        elif entry is not None:
            divergence = self._comparison.compare(json.loads(json.dumps(entry)))
        if divergence is not None:
            raise LedgerDivergedError(divergence)

    def close(self) -> None:
        """Nothing is pending."""
