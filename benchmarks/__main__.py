"""The benchmark: python -m benchmarks, or with the names of some of the sections below.

Compares side by side in one run and prints ratios, since machines are shared and noisy. Writes
bench.json. What needs the real recordings beside the repository is left out where they are not.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from benchmarks import log, mapping, query, semantics, simulation, step
from benchmarks.rows import Row

SECTIONS = {
    "step": step.measure,
    "semantics": semantics.measure_step,
    "perception": semantics.measure_perception,
    "log": log.measure,
    "simulation": simulation.measure,
    "query": query.measure,
    "kitchen": mapping.measure_kitchen,
    "house": mapping.measure_house,
    "memory": mapping.measure_memory,
}


def main(wanted: list[str]) -> None:
    """Measure the wanted sections, or all, and print and write what came out."""
    console = Console()
    rows: list[Row] = []
    for name, measure in SECTIONS.items():
        if wanted and name not in wanted:
            continue
        console.print(f"measuring {name} ...")
        try:
            rows += measure()
        except subprocess.CalledProcessError as error:  # It said why; the others are measured.
            console.print(f"{name} could not be measured: exit code {error.returncode}")
    table = Table("what", "measured", "aim", "", title="proground-log benchmark")
    for row in rows:
        verdict = "" if row.met is None else "met" if row.met else "MISSED"
        table.add_row(row.what, f"{row.value:.3g} {row.unit}", row.aim, verdict)
    console.print(table)
    content = {
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "capability": torch.backends.cpu.get_cpu_capability(),
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
        },
        "rows": [row.to_json() for row in rows],
    }
    Path("bench.json").write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
