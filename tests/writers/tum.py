"""Writes tum data as its public description has it."""

from __future__ import annotations

from proground_log.camera import Calibration, Camera

CAMERA = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)


CALIBRATION = Calibration.registered(CAMERA)
