"""The decoders against plain two-layer networks over concatenated inputs, gradients included."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import linear, relu

from proground_log.field.decoders import Decoders
from proground_log.streams import stream


def test_decoders_are_two_layer_networks_over_concatenated_inputs() -> None:
    decoders = Decoders(32, 48, stream(0, "test decoders"))
    random = stream(1, "test inputs")
    hashed, blob = (
        torch.from_numpy(random.standard_normal((200, width)).astype(np.float32))
        for width in (32, 48)
    )
    hashed.requires_grad_()
    geometry = decoders.geometry(hashed, blob)
    color, hidden = decoders.color(geometry, blob)

    weights = decoders.geometry_hidden, decoders.geometry_out
    expected_geometry = linear(relu(linear(torch.cat([hashed, blob], 1), weights[0])), weights[1])
    inputs = torch.cat([blob, expected_geometry[:, 1:]], 1)
    expected_hidden = relu(linear(inputs, decoders.color_hidden))
    expected_color = torch.sigmoid(linear(expected_hidden, decoders.color_out))

    torch.testing.assert_close(geometry, expected_geometry)
    torch.testing.assert_close(hidden, expected_hidden)
    torch.testing.assert_close(color, expected_color)
    torch.testing.assert_close(decoders.sdf(hashed, blob), expected_geometry[:, 0])

    leaves = [hashed, *decoders.parameters()]
    ours = torch.autograd.grad(color.square().sum() + geometry[:, 0].sum(), leaves)
    reference = torch.autograd.grad(
        expected_color.square().sum() + expected_geometry[:, 0].sum(), leaves
    )
    for mine, theirs in zip(ours, reference, strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-4, rtol=1e-4)
        assert mine.abs().sum() > 0
    assert geometry.shape == (200, 16)
    assert hidden.shape == (200, 32)
