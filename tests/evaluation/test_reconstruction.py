"""Held-out views: what a figure is the mean of, and views that have none."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from proground_log.camera import Camera
from proground_log.evaluation.reconstruction import ViewScore, score_view, view_summary
from proground_log.frame import Frame

CAMERA = Camera(20, 16, 20.0, 20.0, 10.0, 8.0)
SHAPE = (16, 20)


def score(
    depth_m: float, rendered_m: float, *, has_color: bool = True, level: int = 51
) -> ViewScore:
    """A view of one depth, rendered at another and `level` brighter."""
    frame = Frame(
        index=3,
        stamp_ns=0,
        camera=CAMERA,
        world_from_camera=np.eye(4),
        depth_m=np.full(SHAPE, depth_m, np.float32),
        color=np.full((*SHAPE, 3), 100, np.uint8),
        color_valid=np.full(SHAPE, has_color),
        labels=None,
    )
    view = SimpleNamespace(
        color=np.full((*SHAPE, 3), 100 + level, np.uint8),
        depth_m=np.full(SHAPE, rendered_m, np.float32),
    )
    content = SimpleNamespace(render=lambda *_, **__: view)
    return score_view(content, frame)  # type: ignore[arg-type]


WHOLE = score(2.0, 2.5)
WITHOUT_COLOR = score(2.0, 2.25, has_color=False)
WITHOUT_HIT = score(2.0, 0.0)
WITHOUT_DEPTH = score(0.0, 2.0)
FAR = score(7.0, 7.0)


def test_a_view_has_the_figures_that_it_can_be_judged_by() -> None:
    assert WHOLE.psnr_db == pytest.approx(-20 * math.log10(0.2))
    assert (WHOLE.depth_l1_m, WHOLE.missed) == (0.5, 0.0)
    assert (WITHOUT_COLOR.psnr_db, WITHOUT_COLOR.depth_l1_m) == (None, 0.25)
    assert (WITHOUT_HIT.depth_l1_m, WITHOUT_HIT.missed) == (None, 1.0)
    assert (WITHOUT_DEPTH.psnr_db, WITHOUT_DEPTH.missed) == (None, None)
    assert (FAR.psnr_db, FAR.depth_l1_m, FAR.missed) == (WHOLE.psnr_db, None, None)


def test_a_view_without_a_figure_is_left_out_of_its_mean() -> None:
    summary = view_summary([WITHOUT_DEPTH, WHOLE, WITHOUT_COLOR, WITHOUT_HIT, FAR])
    assert summary == {
        "views": 5,
        "psnr_db": pytest.approx(-20 * math.log10(0.2)),
        "ssim": pytest.approx(WHOLE.ssim),
        "depth_l1_cm": pytest.approx(37.5),
        "missed_percent": pytest.approx(100 / 3),
    }


def test_a_figure_that_no_view_has_is_not_there() -> None:
    assert view_summary([WITHOUT_DEPTH]) == {"views": 1}


def test_an_equal_view_has_no_noise_at_all() -> None:
    assert score(2.0, 2.0, level=0).psnr_db == math.inf
