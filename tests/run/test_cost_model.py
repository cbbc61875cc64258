"""Cost models: what they say a stage takes, and what is no cost model."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from proground_log.errors import ProgroundError
from proground_log.mapping.kinds import StageCost
from proground_log.run.cost_model import DEFAULT_MODEL, MOST_NS, UNITS, CostModel, shipped_models

numbers_ns = st.floats(0, 1e12)
units = st.integers(0, 10**7)


def model_of(**stages: tuple[float, float]) -> CostModel:
    costs = {stage: StageCost(a, b, UNITS[stage], 1.5) for stage, (a, b) in stages.items()}
    return CostModel("desk", {"processor": "abacus", "threads": "1"}, "by hand", costs)


MODEL = model_of(decode=(1e6, 17), insert=(2e6, 25), step=(4e6, 1100.5))


# What a stage takes.


@given(numbers_ns, st.floats(0, 1e4), units)
def test_a_cost_is_the_line_to_the_nanosecond(fixed_ns: float, per_unit_ns: float, n: int) -> None:
    cost_ns = model_of(decode=(fixed_ns, per_unit_ns)).cost_ns("decode", n)
    exact = Fraction(fixed_ns) + Fraction(per_unit_ns) * n
    assert isinstance(cost_ns, int)
    assert abs(cost_ns - exact) <= Fraction(1, 2) + exact / 2**50


@given(numbers_ns, st.floats(0, 1e4), units, units)
def test_more_units_never_cost_less(a: float, b: float, first: int, second: int) -> None:
    model = model_of(insert=(a, b))
    fewer, more = sorted((first, second))
    assert model.cost_ns("insert", fewer) <= model.cost_ns("insert", more)


def test_a_step_is_never_free_so_that_a_budget_ends() -> None:
    free = model_of(step=(0, 0), semantic_step=(0, 0))
    assert free.cost_ns("step", 1000) == 1
    assert free.cost_ns("semantic_step", 1000) == 0
    assert free.scaled(1e-3).cost_ns("step", 0) == 1


@given(numbers_ns, st.floats(0, 1e4), units, st.floats(1e-3, 1e3))
def test_a_slower_machine_takes_so_many_times_as_long(
    a: float, b: float, n: int, factor: float
) -> None:
    model = model_of(decode=(a, b))
    scaled_ns = model.scaled(factor).cost_ns("decode", n)
    assert scaled_ns == pytest.approx((a + b * n) * factor, rel=1e-9, abs=0.51)
    assert model.scaled(1.0) == model


def test_scaling_leaves_the_rest_alone() -> None:
    slower = MODEL.scaled(2.5)
    assert slower.stages["decode"] == StageCost(2.5e6, 42.5, "pixel", 1.5)
    assert (slower.name, slower.hardware) == (MODEL.name, MODEL.hardware)
    assert MODEL.stages["decode"].fixed_ns == 1e6


@pytest.mark.parametrize("factor", [0, -1, float("nan"), float("inf"), 1e300])
def test_a_factor_that_makes_no_machine(factor: float) -> None:
    with pytest.raises(ProgroundError, match="--cost-scale"):
        MODEL.scaled(factor)


def test_a_scaled_model_can_always_be_read_back() -> None:
    largest = model_of(step=(1e12, 1e12)).scaled(MOST_NS / 1e12)
    assert CostModel.from_json(largest.to_json(), where="manifest") == largest


def test_a_stage_that_is_not_there_is_named_before_any_work() -> None:
    MODEL.require(["decode", "step"])
    with pytest.raises(ProgroundError, match=r"desk: has no cost of perceive, semantic_step; .*-d"):
        MODEL.require(["decode", "perceive", "semantic_step"])
    with pytest.raises(ProgroundError, match="semantic_step"):
        MODEL.cost_ns("semantic_step", 1)


# As JSON.

costs = {
    stage: st.builds(StageCost, numbers_ns, numbers_ns, st.just(unit), st.floats(0, 100))
    for stage, unit in UNITS.items()
}
texts = st.text(min_size=1).filter(str.strip)
models = st.builds(
    CostModel,
    texts,
    st.dictionaries(st.text(), texts, max_size=3),
    texts,
    st.fixed_dictionaries({}, optional=costs),
)


@given(models)
def test_json_gives_the_same_model_back(model: CostModel) -> None:
    content = json.loads(json.dumps(model.to_json()))
    assert CostModel.from_json(content, where="here") == model


def test_a_file_gives_the_same_model_back(tmp_path: Path) -> None:
    path = tmp_path / "desk.json"
    MODEL.write(path)
    assert CostModel.load(str(path)) == MODEL


def test_a_residual_may_be_left_out(tmp_path: Path) -> None:
    content = MODEL.to_json()
    del content["stages"]["step"]["residual_percent"]
    read = CostModel.from_json(content, where=tmp_path)
    assert read.stages["step"] == StageCost(4e6, 1100.5, "sample", 0.0)


Spoiler = Callable[[dict[str, Any]], object]
STEP_NUMBERS = [-1, float("nan"), float("inf"), 1e16, 10**400, "4", None, True, [1]]
BAD: list[tuple[Spoiler, str]] = [
    (lambda c: c.update(cost_model_version=2), "version 2, this pglog reads 1"),
    (lambda c: c.pop("cost_model_version"), "version None"),
    (lambda c: c.pop("name"), "no entry 'name'"),
    (lambda c: c.update(name=" "), "name is ' '"),
    (lambda c: c.update(measured=3), "measured is 3"),
    (lambda c: c.update(date="today"), "unknown entry 'date'"),
    (lambda c: c.update(hardware="EPYC"), "hardware is str"),
    (lambda c: c["hardware"].update(cores=2), "hardware cores is 2"),
    (lambda c: c.update(stages=[]), "stages is list"),
    (lambda c: c["stages"].update(render={}), "stage render has no entry 'fixed_ns'"),
    (lambda c: c["stages"].update(step=7), "stage step is int"),
    (lambda c: c["stages"]["step"].pop("fixed_ns"), "stage step has no entry 'fixed_ns'"),
    (lambda c: c["stages"]["step"].update(sd=1), "stage step has an unknown entry 'sd'"),
    (lambda c: c["stages"]["step"].update(unit="pixel"), "step by 'pixel', not by 'sample'"),
    (lambda c: c["stages"]["step"].update(residual_percent=-2), "residual_percent of step is -2"),
    *(
        (lambda c, n=n: c["stages"]["step"].update(per_unit_ns=n), "per_unit_ns of step is")
        for n in STEP_NUMBERS
    ),
    *(
        (lambda c, n=n: c["stages"]["decode"].update(fixed_ns=n), "fixed_ns of decode is")
        for n in STEP_NUMBERS
    ),
]


@pytest.mark.parametrize(("spoil", "complaint"), BAD)
def test_a_file_with_a_fault_is_refused(tmp_path: Path, spoil: Spoiler, complaint: str) -> None:
    content = MODEL.to_json()
    spoil(content)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ProgroundError) as error:
        CostModel.load(str(path))
    assert complaint in error.value.what
    assert error.value.where == str(path)
    assert "pglog" in error.value.todo


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"7", b"\xff\xfe", b'{"a": 1}'])
def test_a_file_that_is_something_else(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "else.json"
    path.write_bytes(content)
    with pytest.raises(ProgroundError, match=r"else\.json"):
        CostModel.load(str(path))


# By name.


def test_every_shipped_model_knows_every_stage() -> None:
    assert DEFAULT_MODEL in shipped_models()
    for name in shipped_models():
        model = CostModel.load(name)
        assert model.name == name
        model.require(UNITS)
        assert min(model.cost_ns(stage, 1000) for stage in UNITS) > 0


@pytest.mark.parametrize("name", ["laptop", "gone/laptop.json", f"{DEFAULT_MODEL}.json"])
def test_an_unknown_name_lists_those_that_there_are(name: str) -> None:
    with pytest.raises(ProgroundError, match=DEFAULT_MODEL) as error:
        CostModel.load(name)
    assert error.value.where == name
    assert DEFAULT_MODEL in error.value.todo


@pytest.mark.parametrize("name", ["", "."])
def test_a_folder_is_no_model(name: str) -> None:
    with pytest.raises(ProgroundError, match="folder"):
        CostModel.load(name)
