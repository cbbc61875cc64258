"""What is said once about training: Adam's settings, and its state to and from arrays."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

ADAM_BETAS = (0.9, 0.99)


def training_state(module: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, np.ndarray]:
    """Parameters as "field/NAME" and moments as "optimiser/NUMBER/NAME"; views, not copies."""
    tensors = {f"field/{name}": p.detach() for name, p in module.named_parameters()}
    for number, moments in optimiser.state_dict()["state"].items():
        for name, value in moments.items():
            tensors[f"optimiser/{number}/{name}"] = value
    return {name: tensor.cpu().numpy() for name, tensor in tensors.items()}


def restore_training(
    module: nn.Module, optimiser: torch.optim.Optimizer, state: dict[str, np.ndarray]
) -> None:
    """Go back to what `training_state` returned."""
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            parameter.copy_(torch.from_numpy(state[f"field/{name}"]))
    saved = optimiser.state_dict()
    saved["state"] = {}
    for name, array in sorted(state.items()):
        part, _, rest = name.partition("/")
        if part == "optimiser":
            number, _, moment = rest.partition("/")
            saved["state"].setdefault(int(number), {})[moment] = torch.from_numpy(array.copy())
    optimiser.load_state_dict(saved)


def under(prefix: str, state: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The entries whose name begins with "PREFIX/", without it."""
    return {
        name.removeprefix(f"{prefix}/"): array
        for name, array in state.items()
        if name.startswith(f"{prefix}/")
    }
