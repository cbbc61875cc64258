"""`python -m tests.fuzz [TARGET ...]`: feeds hostile files to everything that reads any."""

from __future__ import annotations

import argparse
import sys
from math import inf
from pathlib import Path

from tests.fuzz import campaign
from tests.fuzz.targets import TARGETS


def main() -> int:
    """Run the targets; returns 1 where something was found, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("target", nargs="*", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--seconds", type=float, default=60, help="for each target")
    parser.add_argument("--inputs", type=int, help="for each target, however long it takes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"))
    options = parser.parse_args()
    if unknown := sorted(set(options.target) - set(TARGETS)):
        parser.error(f"no target {', '.join(unknown)}; valid: {', '.join(TARGETS)}")
    print(f"{'target':18}{'inputs/s':>9}{'results':>9}{'errors':>9}{'slowest':>10}{'memory':>10}")
    has_findings = False
    for name in options.target or TARGETS:
        tally = campaign.run(
            name,
            seed=options.seed,
            inputs=None if options.inputs is None else options.inputs + 1,
            seconds=options.seconds if options.inputs is None else inf,
            findings_folder=options.findings,
        )
        rate = (tally.results + tally.errors) / tally.seconds
        print(
            f"{name:18}{rate:9.0f}{tally.results:9}{tally.errors:9}"
            f"{tally.slowest_s:8.2f} s{tally.growth_kb / 1024:7.0f} MB",
            flush=True,
        )
        for finding in tally.findings:
            has_findings = True
            print(f"\n{name}, seed {options.seed}, input {finding.number}: {finding.saved}")
            print(finding.what, end="\n\n", flush=True)
    return int(has_findings)


if __name__ == "__main__":
    sys.exit(main())
