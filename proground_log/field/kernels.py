"""CPU kernels of the two encodings, compiled by numba.

Bit-exact at any number of threads: the forward passes split the points, which do not depend on
each other; the backward pass splits the levels, each of which owns its slice of the table, and
walks the points of a level in their order.
"""

from __future__ import annotations

import numba
import numpy as np

PRIME_Y = np.uint32(2654435761)
PRIME_Z = np.uint32(805459861)

_ONE, _HALF, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(0.0)


@numba.njit(inline="always")
def _steps(iy, iz, resolution, dense):  # type: ignore[no-untyped-def]
    """What the lower and upper corners along y and z contribute to a row of the table."""
    side = np.uint32(resolution + np.uint32(1))
    step_y = side if dense else PRIME_Y
    step_z = np.uint32(side * side) if dense else PRIME_Z
    y0, z0 = np.uint32(iy * step_y), np.uint32(iz * step_z)
    return y0, np.uint32(y0 + step_y), z0, np.uint32(z0 + step_z)


@numba.njit(inline="always")
def _row(x, y, z, mask, dense):  # type: ignore[no-untyped-def]
    """Row of a corner within its level's slice of the table."""
    return np.uint32(x + y + z) if dense else np.uint32((x ^ y ^ z) & mask)


@numba.njit
def _interpolate(points, start, stop, table, scale, resolution, mask, dense, first, features):  # type: ignore[no-untyped-def]
    """One level's two features of the points start to stop, into columns first and first + 1."""
    for n in range(start, stop):
        x, y = points[n, 0] * scale + _HALF, points[n, 1] * scale + _HALF
        z = points[n, 2] * scale + _HALF
        ix, iy, iz = np.uint32(x), np.uint32(y), np.uint32(z)
        fx, fy, fz = x - np.float32(ix), y - np.float32(iy), z - np.float32(iz)
        y0, y1, z0, z1 = _steps(iy, iz, resolution, dense)
        a, b = _ZERO, _ZERO
        for corner in range(8):
            dx, dy, dz = corner & 1, corner & 2, corner & 4
            weight = (fx if dx else _ONE - fx) * (fy if dy else _ONE - fy)
            weight *= fz if dz else _ONE - fz
            row = _row(ix + np.uint32(dx), y1 if dy else y0, z1 if dz else z0, mask, dense)
            a += weight * table[row, 0]
            b += weight * table[row, 1]
        features[n, first] = a
        features[n, first + 1] = b


@numba.njit
def _scatter(points, gradient, scale, resolution, mask, dense, first, table_gradient):  # type: ignore[no-untyped-def]
    """Add one level's feature gradients, columns first and first + 1, into its table slice."""
    for n in range(points.shape[0]):
        a, b = gradient[n, first], gradient[n, first + 1]
        if a == 0 and b == 0:
            continue
        x, y = points[n, 0] * scale + _HALF, points[n, 1] * scale + _HALF
        z = points[n, 2] * scale + _HALF
        ix, iy, iz = np.uint32(x), np.uint32(y), np.uint32(z)
        fx, fy, fz = x - np.float32(ix), y - np.float32(iy), z - np.float32(iz)
        y0, y1, z0, z1 = _steps(iy, iz, resolution, dense)
        for corner in range(8):
            dx, dy, dz = corner & 1, corner & 2, corner & 4
            weight = (fx if dx else _ONE - fx) * (fy if dy else _ONE - fy)
            weight *= fz if dz else _ONE - fz
            row = _row(ix + np.uint32(dx), y1 if dy else y0, z1 if dz else z0, mask, dense)
            table_gradient[row, 0] += weight * a
            table_gradient[row, 1] += weight * b


@numba.njit(parallel=True, cache=True)
def hash_grid_forward(points, table, scales, resolutions, offsets, masks, stretches, features):  # type: ignore[no-untyped-def]
    """Interpolate the features of every level.

    points: float32 [N, 3] in [0, 1]; table: float32 [rows, 2]; features: float32 [N, 2 levels],
    written. scales float32, resolutions uint32, offsets int64 [levels + 1], masks uint32, one a
    level; a mask of 0 marks a dense level. The points are split into `stretches`, best one a
    thread: going level after level, a thread then keeps a level's slice of the table in its cache.
    """
    length = (points.shape[0] + stretches - 1) // stretches
    for stretch in numba.prange(stretches):
        start = min(points.shape[0], stretch * length)
        stop = min(points.shape[0], start + length)
        for level in range(scales.shape[0]):
            part = table[offsets[level] : offsets[level + 1]]
            scale, resolution, mask = scales[level], resolutions[level], masks[level]
            if mask == 0:
                _interpolate(
                    points, start, stop, part, scale, resolution, mask, True, 2 * level, features
                )
            else:
                _interpolate(
                    points, start, stop, part, scale, resolution, mask, False, 2 * level, features
                )


@numba.njit(parallel=True, cache=True)
def hash_grid_backward(points, gradient, scales, resolutions, offsets, masks, table_gradient):  # type: ignore[no-untyped-def]
    """Write the table's gradient, given that of the features, float32 [N, 2 levels]."""
    for level in numba.prange(scales.shape[0]):
        part = table_gradient[offsets[level] : offsets[level + 1]]
        part[:] = _ZERO
        scale, resolution, mask = scales[level], resolutions[level], masks[level]
        if mask == 0:
            _scatter(points, gradient, scale, resolution, mask, True, 2 * level, part)
        else:
            _scatter(points, gradient, scale, resolution, mask, False, 2 * level, part)


@numba.njit(inline="always")
def _quartic_cdf(u):  # type: ignore[no-untyped-def]
    """Integral of the quartic kernel from 0 to u; constant outside [-1, 1]."""
    u = min(max(u, -_ONE), _ONE)
    u2 = u * u
    return np.float32(15 / 16) * u * (_ONE - np.float32(2 / 3) * u2 + np.float32(0.2) * u2 * u2)


@numba.njit(parallel=True, cache=True)
def one_blob_forward(points, bins, encoding):  # type: ignore[no-untyped-def]
    """Write the one-blob encoding, float32 [N, 3 bins], of points, float32 [N, 3] in [0, 1].

    The kernel reaches one bin to each side, so only a point's own bin and its two neighbours
    (around the corner at the ends) are not zero.
    """
    for n in numba.prange(points.shape[0]):
        for axis in range(3):
            for k in range(bins):
                encoding[n, axis * bins + k] = _ZERO
            position = points[n, axis] * np.float32(bins)
            own = min(np.int64(position), bins - 1)
            left = _quartic_cdf(np.float32(own - 1) - position)
            for k in range(own - 1, own + 2):
                right = _quartic_cdf(np.float32(k + 1) - position)
                encoding[n, axis * bins + k % bins] += right - left
                left = right
