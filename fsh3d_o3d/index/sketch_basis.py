"""Directions in which descriptors of shapes differ most, learned from shapes that are made up.

A sketch of a descriptor is its projection onto these. A basis learned from a few hundred unions of boxes, cylinders and
ellipsoids serves real shapes nearly as well as one learned from them (figures in ``docs/library.md``), so that it
depends on nothing but the option: a new row needs no training, and no row ever has to be sketched again. It is made
once for an index and kept in it.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.geometry import MeshArrays
from fsh3d_o3d.index.codec import SKETCH_LENGTH
from fsh3d_o3d.index.extraction import describe
from fsh3d_o3d.jobs import CachedDescriptor, DescriptorCache, key_of
from fsh3d_o3d.sphere import icosphere

_EXAMPLES = 300  # made-up shapes, more than twice the directions that are learned; three to five seconds
_TYPICAL_NORM = 8.0  # of a sketch: far from both ends of float16
_SIDES = 12  # of a cylinder; a choice, features hardly see facets


@functools.lru_cache(maxsize=4)
def sketch_basis(option: SHDOption) -> NDArray[np.float16]:
    """Return the basis (d, SKETCH_LENGTH): orthogonal columns of equal length, and zeros where there are fewer.

    Takes seconds for features that take long, but for the first time only: it is kept beside cached descriptors.
    """
    key = key_of(b"sketch basis 1", option.fingerprint.encode())
    shape = option.feature_shape[0] * option.feature_shape[1], SKETCH_LENGTH
    with DescriptorCache() as cache:
        found = cache.find([key]).get(key)
        if found is None or found.values.size != shape[0] * shape[1]:
            found = CachedDescriptor(_learned(option).astype(np.float32).ravel(), 0.0)
            cache.keep(key, found)
    basis = found.values.reshape(shape).astype(np.float16)
    basis.setflags(write=False)
    return basis


def _learned(option: SHDOption) -> NDArray[np.float16]:
    features = np.stack([describe(example_shape(number), option).feature for number in range(_EXAMPLES)])
    directions = np.linalg.svd(features.astype(np.float64), full_matrices=False)[2][:SKETCH_LENGTH]
    scale = 2.0 ** np.round(np.log2(_TYPICAL_NORM / np.linalg.norm(features, axis=1).mean()))
    basis = np.zeros((features.shape[1], SKETCH_LENGTH), dtype=np.float16)
    basis[:, : len(directions)] = scale * directions.T
    return basis


def example_shape(number: int) -> MeshArrays:
    """Return a union of simple bodies, often with a plane of symmetry or two, as furniture and animals have."""
    random = np.random.default_rng(number)
    planes = int(random.choice(3, p=(0.4, 0.4, 0.2)))
    vertices: list[Float64Array] = []
    triangles: list[IntArray] = []
    for part in range(int(random.integers(1, 9))):
        body, faces = _bodies()[random.integers(3)]
        size = np.exp(random.normal(0, 0.8, 3) + random.normal(-0.5, 0.5))
        turn = Rotation.random(random_state=random).as_matrix() if random.random() < 0.35 else np.eye(3)
        place = random.normal(0, 1.3, 3) if part else np.zeros(3)
        copies = [((body * size) @ turn.T + place, faces)]
        for axis in range(planes):
            mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
            copies += [(copy * mirror, wound[:, ::-1]) for copy, wound in copies]
        for copy, wound in copies:
            triangles.append(wound + sum(map(len, vertices)))
            vertices.append(copy)
    return MeshArrays(np.concatenate(vertices), np.concatenate(triangles))


@functools.lru_cache(maxsize=1)
def _bodies() -> tuple[tuple[Float64Array, IntArray], ...]:
    """A ball, a box and a cylinder of size 2."""
    return icosphere(4), _prism(4), _prism(_SIDES)


def _prism(sides: int) -> tuple[Float64Array, IntArray]:
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.column_stack((np.cos(angle), np.sin(angle))) / np.cos(np.pi / sides)
    rings = [np.column_stack((ring, np.full(sides, height))) for height in (-1.0, 1.0)]
    here = np.arange(sides)
    following = (here + 1) % sides
    bottom, top = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [
        (here, following, following + sides),
        (here, following + sides, here + sides),
        (following, here, bottom),
        (here + sides, following + sides, top),
    ]
    vertices = np.concatenate((*rings, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    return vertices, np.concatenate([np.column_stack(face) for face in faces])
