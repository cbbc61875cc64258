"""The task: what the robot should know about, in words (paper, T)."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from proground_log.checked import Checks
from proground_log.files import require_file
from proground_log.palette import label_colors

_COLOR = re.compile(r"#[0-9a-fA-F]{6}")
_REMEDY = "see docs/tasks.md"


@dataclass(frozen=True)
class Thresholds:
    """Where perception and mapper draw their lines."""

    detection: float = 0.05
    """Regions below this relevance do not go into a log."""
    overlap: float = 0.7
    """Boxes that overlap by more than this (intersection over union) are one region."""
    relevance: float = 0.4
    """lambda_tau (Eq. 3): the mapper learns semantics from regions above it."""


@dataclass(frozen=True)
class Task:
    """What to look for.

    Args:
        name: what people call it.
        prompts: what matters, in words; not empty, none twice.
        irrelevant: further prompts that matter to nobody; they show how prompts disturb each
            other (paper, Table 3).
        thresholds: see `Thresholds`.
        colors: "#rrggbb" by prompt, for people; the others get colours of their own.
    """

    name: str
    prompts: tuple[str, ...]
    irrelevant: tuple[str, ...] = ()
    thresholds: Thresholds = Thresholds()
    colors: dict[str, str] = field(default_factory=dict)

    @property
    def all_prompts(self) -> tuple[str, ...]:
        """Prompts and irrelevant prompts, in the order of relevance, labels and texts."""
        return self.prompts + self.irrelevant

    @property
    def sha256(self) -> str:
        """Fingerprint of all that decides what is found and learnt, hexadecimal."""
        content = {name: value for name, value in self.to_json().items() if name != "colors"}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def prompt_colors(self) -> np.ndarray:
        """RGB colours of all prompts, uint8 [K, 3]: those given, else those of labels."""
        colors = label_colors(len(self.all_prompts) + 1)[1:]
        for number, prompt in enumerate(self.all_prompts):
            if prompt in self.colors:
                colors[number] = list(bytes.fromhex(self.colors[prompt][1:]))
        return colors

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        content = asdict(self)
        return {**content, "prompts": list(self.prompts), "irrelevant": list(self.irrelevant)}

    @classmethod
    def from_json(cls, content: dict[str, Any], *, where: object) -> Task:
        """Check a task's content; raises a ProgroundError that names what is wrong."""
        checks = Checks(where, _REMEDY)
        checks.entries(content, "the task", cls.__dataclass_fields__)
        name = checks.text(content.get("name"), "name")
        prompts = _prompts(content.get("prompts", []), "prompts", checks)
        irrelevant = _prompts(content.get("irrelevant", []), "irrelevant", checks)
        if not prompts:
            raise checks.fault("has no prompts")
        seen: set[str] = set()
        for prompt in prompts + irrelevant:
            if prompt in seen:
                raise checks.fault(f"has the prompt {prompt!r} twice")
            seen.add(prompt)
        colors = content.get("colors", {})
        for prompt, color in colors.items() if isinstance(colors, dict) else [("colors", colors)]:
            if prompt not in seen:
                raise checks.fault(f"gives a colour to {prompt!r}, which is no prompt")
            if not isinstance(color, str) or not _COLOR.fullmatch(color):
                raise checks.fault(f"gives {prompt!r} the colour {color!r}, not #rrggbb")
        thresholds = content.get("thresholds", {})
        return cls(name.strip(), prompts, irrelevant, _thresholds(thresholds, checks), dict(colors))


def read_task(path: Path) -> Task:
    """Read a task from a TOML file; raises a ProgroundError that names what is wrong."""
    try:
        content = tomllib.loads(require_file(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Checks(path, _REMEDY).fault(f"is no TOML ({error})") from error
    return Task.from_json(content, where=path)


def _prompts(value: object, entry: str, checks: Checks) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(prompt, str) for prompt in value):
        raise checks.fault(f"{entry} is no list of texts")
    prompts = tuple(" ".join(prompt.split()).lower() for prompt in value)
    if "" in prompts:
        raise checks.fault(f"has an empty text among its {entry}")
    return prompts


def _thresholds(value: object, checks: Checks) -> Thresholds:
    entries = checks.entries(value, "thresholds", Thresholds.__dataclass_fields__)
    return Thresholds(
        **{key: checks.number(number, f"the threshold {key}", 1) for key, number in entries.items()}
    )
