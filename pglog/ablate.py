"""The command that repeats the paper's ablations: ablate."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

from rich.table import Column, Table

from pglog.common import SAME, Log, Output, out, shown_progress
from proground_log.run.settings import ReplayConfig

if TYPE_CHECKING:
    from proground_log.log.reader import LogReader
    from proground_log.perception.perceiver import Perceiver
    from proground_log.perception.task import Task
    from replay.ablation.variants import Variant


def ablate_command(
    log: Log,
    *,
    output: Output,
    table: Literal[2, 3, 4],
    seeds: int = 5,
    steps: int = 10,
    threads: int | None = None,
) -> int:
    """Repeat one of the paper's ablations with the simulated detector; see docs/ablations.md.

    2: weighting and filtering; 3: irrelevant prompts; 4: embedding spaces, and loss curves.
    A seed that was finished is not computed again.

    Args:
        log: a log with labels and a labelled mesh (.mcap).
        output: folder for table, CSV files and plots.
        table: which of the paper's tables.
        seeds: so many runs, each with other draws and other errors of the detector.
        steps: optimisation steps a frame gets.
        threads: compute on so many; the result is the same for any number.
    """
    from proground_log.files import file_sha256
    from proground_log.log.reader import LogReader
    from proground_log.perception.builtin_texts import BuiltinTexts
    from replay.ablation.report import (
        columns,
        draw,
        read_outcomes,
        table_rows,
        write_csv,
        write_outcomes,
    )
    from replay.ablation.variants import run_variants
    from replay.device import set_threads

    set_threads(threads)
    reader = LogReader(log)
    task = _task(reader)
    results = {}
    for seed in range(seeds):
        config = ReplayConfig(steps=steps, seed=seed)
        content = [file_sha256(log), task.sha256, table, asdict(config)]
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        path = output / f"table{table}_seed{seed}.json"
        if read_outcomes(path, key) is None:
            perceiver_of = _perceivers(reader, task, seed)
            with shown_progress(f"seed {seed}") as progress:
                variants = _variants(table, config, task, seed)
                texts = BuiltinTexts()
                outcomes = run_variants(reader, variants, perceiver_of, texts, config, progress)
            write_outcomes(path, key, outcomes)
        found = read_outcomes(path, key)
        assert found is not None
        results[seed] = found
    some = list(results.values())
    printed = Table(Column("variant"), *(Column(c, justify="right") for c in columns(some)))
    for row in table_rows(some):
        printed.add_row(*row.values())
    print(f"table {table}, mean ± standard deviation of {seeds} seeds")
    out.print(printed)
    for path in (*write_csv(output, table, results), *draw(output, table, results)):
        print(path)
    return SAME


def _task(reader: LogReader) -> Task:
    """The log's own task, or all of its classes."""
    from proground_log.perception.of_log import perception_of
    from proground_log.perception.opening import PerceptionOptions, asked_task

    description = perception_of(reader)
    return asked_task(reader, PerceptionOptions()) if description is None else description.task


def _perceivers(reader: LogReader, task: Task, seed: int) -> Callable[[Task | None], Perceiver]:
    from proground_log.perception.opening import simulated_perceiver

    return lambda other: simulated_perceiver(reader, other or task, seed)


def _variants(table: int, config: ReplayConfig, task: Task, seed: int) -> list[Variant]:
    from proground_log.perception.builtin_texts import BuiltinTexts
    from replay.ablation import variants as ablate

    settings = config.mapper.semantics
    if table == 2:
        return ablate.weighting_and_filtering(settings)
    if table == 4:
        return ablate.embedding_spaces(settings)
    texts = BuiltinTexts()
    meant = {texts.concept(prompt) for prompt in task.prompts}
    names = [name for name in texts.concepts if name not in meant]
    return ablate.irrelevant_prompts(settings, task, names, seed)
