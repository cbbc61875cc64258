"""Cost models: what each stage of a replay takes on some machine, as fixed + per_unit * units.

A replay under a budget asks a cost model and no clock, so that it comes out the same everywhere.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from proground_log.checked import Checks
from proground_log.errors import ProgroundError
from proground_log.files import require_file, written_whole
from proground_log.mapping.kinds import StageCost

COST_MODEL_VERSION = 1
DEFAULT_MODEL = "epyc-2-threads"
UNITS = {
    "decode": "pixel",
    "perceive": "image",
    "insert": "pixel",
    "semantic_insert": "pixel",
    "step": "sample",
    "semantic_step": "sample",
}
"""What the units of the known stages are: pixels of colour and depth together for decode, of depth
alone for both kinds of insert; rays times samples for both kinds of step. Mappers of other packages
have stages and units of their own."""
MOST_NS = 1e15
"""No number of a cost model is larger: eleven days."""
_SHIPPED = Path(__file__).parent / "cost_models"
_REMEDY = "measure one with `pglog calibrate`, or see docs/budgets.md"


@dataclass(frozen=True)
class CostModel:
    """What each stage takes on one machine.

    Args:
        name: what people call it.
        hardware: the machine, by keyword: processor, cores, threads.
        measured: how, in words.
        stages: costs by stage; those that were not measured are absent.
    """

    name: str
    hardware: dict[str, str]
    measured: str
    stages: dict[str, StageCost]

    def require(self, stages: Iterable[str]) -> None:
        """Raise a ProgroundError unless it knows the cost of all these stages."""
        missing = [stage for stage in stages if stage not in self.stages]
        if missing:
            option = " --detector" if "perceive" in missing else ""
            raise ProgroundError(
                f"has no cost of {', '.join(missing)}",
                where=f"cost model {self.name}",
                todo=f"measure it with `pglog calibrate{option}`, or choose another cost model",
            )

    def cost_ns(self, stage: str, units: int) -> int:
        """What a stage takes for so many units, in whole nanoseconds.

        A step takes 1 at least, so that a budget has an end.

        Raises:
            ProgroundError: the stage is unknown to this model.
        """
        self.require([stage])
        cost = self.stages[stage]
        return max(round(cost.fixed_ns + cost.per_unit_ns * units), int(stage == "step"))

    def scaled(self, factor: float) -> CostModel:
        """The model of a machine that takes `factor` times as long for everything.

        Raises:
            ProgroundError: the factor is not above 0, or absurdly large.
        """
        stages = {
            stage: dataclasses.replace(
                cost, fixed_ns=cost.fixed_ns * factor, per_unit_ns=cost.per_unit_ns * factor
            )
            for stage, cost in self.stages.items()
        }
        numbers = [n for cost in stages.values() for n in (cost.fixed_ns, cost.per_unit_ns)]
        if not 0 < factor < math.inf or max(numbers, default=0.0) > MOST_NS:
            raise ProgroundError(
                f"a machine cannot be {factor} times slower",
                where="--cost-scale",
                todo="use a number above 0; 2 is half as fast",
            )
        return dataclasses.replace(self, stages=stages)

    def with_costs(self, costs: Mapping[str, StageCost], factor: float) -> CostModel:
        """The model with costs, times a factor, of stages that it does not know."""
        scaled = dataclasses.replace(self, stages=dict(costs)).scaled(factor).stages
        return dataclasses.replace(self, stages={**scaled, **self.stages})

    def to_json(self) -> dict[str, Any]:
        """As JSON values; see docs/budgets.md."""
        return {"cost_model_version": COST_MODEL_VERSION, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, content: object, *, where: object) -> CostModel:
        """Check a cost model's content; raises a ProgroundError that names what is wrong."""
        checks = Checks(where, _REMEDY)
        version = checks.entries(content, "the cost model").get("cost_model_version")
        if version != COST_MODEL_VERSION:
            raise ProgroundError(
                f"has cost model version {version!r}, this pglog reads {COST_MODEL_VERSION}",
                where=where,
                todo="measure it again with this version of pglog",
            )
        names = {"cost_model_version", *(field.name for field in dataclasses.fields(cls))}
        entries = checks.entries(content, "the cost model", names, names)
        hardware = checks.entries(entries["hardware"], "hardware")
        stages = checks.entries(entries["stages"], "stages")
        return cls(
            name=checks.text(entries["name"], "name"),
            hardware={key: checks.text(text, f"hardware {key}") for key, text in hardware.items()},
            measured=checks.text(entries["measured"], "measured"),
            stages={stage: _stage(stage, content, checks) for stage, content in stages.items()},
        )

    @classmethod
    def load(cls, name_or_path: str) -> CostModel:
        """A cost model that ships with pglog, by its name, or the one in a file.

        Raises:
            ProgroundError: there is none of this name, or the file is none.
        """
        path = Path(name_or_path)
        if name_or_path in shipped_models():
            path = _SHIPPED / f"{name_or_path}.json"
        elif not path.exists():
            raise ProgroundError(
                "there is no cost model of this name, and no such file",
                where=name_or_path,
                todo=f"choose {', '.join(shipped_models())}, or a file of `pglog calibrate`",
            )
        try:
            content = json.loads(require_file(path).read_text(encoding="utf-8"))
        except ValueError as error:
            raise Checks(path, _REMEDY).fault(f"is no JSON ({error})") from error
        return cls.from_json(content, where=path)

    def write(self, path: Path) -> None:
        """Write it as JSON, whole or not at all."""
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(self.to_json(), indent=2) + "\n", encoding="utf-8")


def shipped_models() -> tuple[str, ...]:
    """Names of the cost models that ship with pglog."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.json")))


def _stage(stage: str, content: object, checks: Checks) -> StageCost:
    needed = {"fixed_ns", "per_unit_ns", "unit"}
    entries = checks.entries(content, f"stage {stage}", {*needed, "residual_percent"}, needed)
    unit = checks.text(entries["unit"], f"unit of {stage}")
    if unit != UNITS.get(stage, unit):
        raise checks.fault(f"counts {stage} by {unit!r}, not by {UNITS[stage]!r}")
    numbers = {
        key: checks.number(value, f"{key} of {stage}", MOST_NS)
        for key, value in entries.items()
        if key != "unit"
    }
    return StageCost(unit=unit, **numbers)
