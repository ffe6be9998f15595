"""Poses from local harmonics: one pair of matched points is already a whole pose.

``local_poses(source, target)`` takes the ``LocalHarmonics`` of two shapes, made with the same radius, to the poses that
their matches stand for and a score for each, best first. In the frames of two matched points the coefficients differ
by a turn about the normal alone, c(s, l, ±m) → e^{imα} c, and maybe by the normal's sign; the correlation over all
angles is a short Fourier series in α. Its maximum is the turn, and its height, relative to the norms, the score.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.descriptors import LocalHarmonics
from fsh3d_o3d.registration.fit import Poses

_ANGLES = 48  # turns that are looked at; a parabola through the highest three gives the rest
_WHITENING = 0.5  # power of the usual size of a coefficient that all are divided by; 1 would weigh noise as much
_ALIKE = 1e-6  # of the norm; coefficients that vary less among all key points tell nothing


def local_poses(
    source: LocalHarmonics, target: LocalHarmonics, *, nearest: int = 3, most: int = 300
) -> tuple[Poses, Float64Array]:
    """Return poses that take matched points and frames onto each other, and their scores (k,), best first.

    A score is a correlation, in [−1, 1].

    Args:
        source: What is moved.
        target: What stays; of the same radius.
        nearest: Every key point of the source is tried with so many of the target, those of the nearest features.
        most: Poses that are returned; none where either side has no key points.
    """
    if not len(source) or not len(target):
        return Poses(np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 3))), np.zeros(0)
    first, second = _matches(source.feature, target.feature, nearest)
    ours, theirs = _whitened(source.coefficients, target.coefficients)
    scores, angles = _correlations(ours, theirs, first, second)
    pair, flipped = np.divmod(np.argsort(-scores, axis=None, kind="stable")[:most], 2)
    turned = _turns(angles[pair, flipped])
    sign = np.where(flipped[:, None], [[1.0, -1.0, -1.0]], [[1.0, 1.0, 1.0]])
    frames = target.frames[second[pair]] * sign[:, :, None]
    rotations = np.swapaxes(frames, 1, 2) @ turned @ source.frames[first[pair]]
    shifts = target.points[second[pair]] - np.einsum("kij,kj->ki", rotations, source.points[first[pair]])
    return Poses(rotations, np.ones(len(pair)), shifts), scores[pair, flipped]


def _matches(source: Float64Array, target: Float64Array, nearest: int) -> tuple[IntArray, IntArray]:
    """Pairs of rows: every one of the source with its nearest of the target."""
    count = min(nearest, len(target))
    # Both are of unit norm, so that the largest product is the smallest distance.
    product = source.astype(np.float32) @ target.astype(np.float32).T
    found = np.argpartition(-product, count - 1, axis=1)[:, :count]
    return np.repeat(np.arange(len(source)), count), found.ravel()


def _whitened(
    source: NDArray[np.float32], target: NDArray[np.float32]
) -> tuple[list[NDArray[np.complex64]], list[NDArray[np.complex64]]]:
    """Coefficients without what all have in common, each divided by a power of its usual size, order by order.

    One array (k, S (b − m)) an order m ≥ 0; of unit norm together.
    """
    both = np.concatenate((source, target))
    both /= np.maximum(np.linalg.norm(both, axis=(1, 2), keepdims=True), np.finfo(np.float32).tiny)
    bandwidth = int(np.sqrt(both.shape[2]))
    orders = []
    for m in range(bandwidth):
        degree = np.arange(m, bandwidth)
        centre = degree * degree + degree
        part = both[:, :, centre + m].astype(np.complex64)
        if m:
            part.imag = both[:, :, centre - m]
        else:
            part -= part.mean(axis=0)  # of a flat place; all other orders have no mean
        size = np.sqrt(np.mean(part.real**2 + part.imag**2, axis=0))
        part /= np.maximum(size, _ALIKE) ** np.float32(_WHITENING)
        orders.append(part.reshape(len(both), -1))
    norm = np.sqrt(sum(np.einsum("kd,kd->k", part, part.conj()).real for part in orders))
    norm = np.maximum(norm, np.finfo(np.float32).tiny)[:, None]
    count = len(source)
    return [part[:count] / norm[:count] for part in orders], [part[count:] / norm[count:] for part in orders]


def _correlations(
    source: list[NDArray[np.complex64]],
    target: list[NDArray[np.complex64]],
    first: IntArray,
    second: IntArray,
) -> tuple[Float64Array, Float64Array]:
    """Highest correlations (k, 2) over all turns about the normal, and the turns, for either sign of the normal."""
    bandwidth = len(source)
    series = np.empty((len(first), 2, bandwidth), dtype=np.complex64)
    shells = source[0].shape[1] // bandwidth
    for m, (ours, theirs) in enumerate(zip(source, target, strict=True)):
        here, there = np.conj(ours[first]), theirs[second]
        series[:, 0, m] = np.einsum("kd,kd->k", here, there)
        # Upside down, that is turned by π about the first axis: y and z change their signs.
        parity = np.tile((-1.0) ** np.arange(2 * m, m + bandwidth), shells).astype(np.float32)
        series[:, 1, m] = np.einsum("kd,kd->k", here, np.conj(there) * parity)
    step = 2 * np.pi / _ANGLES
    waves = np.exp(-1j * step * np.outer(np.arange(bandwidth), np.arange(_ANGLES))).astype(np.complex64)
    values = (series.reshape(-1, bandwidth) @ waves).real
    rows, highest = np.arange(len(values)), values.argmax(axis=1)
    before, peak, after = (values[rows, (highest + shift) % _ANGLES].astype(np.float64) for shift in (-1, 0, 1))
    bend = np.maximum(2 * peak - before - after, np.finfo(np.float32).tiny)
    shift = np.clip((after - before) / (2 * bend), -0.5, 0.5)
    scores = peak + shift * (after - before) / 4
    return scores.reshape(-1, 2), (step * (highest + shift)).reshape(-1, 2)


def _turns(angles: Float64Array) -> Float64Array:
    """Rotations (k, 3, 3) about the z axis."""
    result = np.zeros((len(angles), 3, 3))
    result[:, 0, 0] = result[:, 1, 1] = np.cos(angles)
    result[:, 1, 0] = np.sin(angles)
    result[:, 0, 1] = -result[:, 1, 0]
    result[:, 2, 2] = 1
    return result
