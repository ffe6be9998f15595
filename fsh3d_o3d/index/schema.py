"""What the tables of an index hold: one row a file, and the directions of its sketches.

``path`` is an unenforced primary key of Lance: with it, and only with it, two writers that insert the same path at the
same moment notice, and one of them tries again.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.index.checksums import CHECKSUM
from fsh3d_o3d.index.codec import SKETCH_LENGTH, signature_type
from fsh3d_o3d.index.columns import fixed_lists, vectors
from fsh3d_o3d.index.errors import ShapeIndexError

_KEY = {"lance-schema:unenforced-primary-key": "true"}
_BASIS_CHECKSUM = "fsh3d.checksum"


def model_schema(option: SHDOption, version: int) -> Any:
    """Return the columns of ``models``; ``version`` is of the format."""
    pa = import_installed("pyarrow")

    fields = [
        pa.field("path", pa.binary(), nullable=False, metadata=_KEY),  # the file's, as LibraryRoots has it
        pa.field("content", pa.binary(32)),  # SHA-256
        pa.field("identity", pa.binary()),  # content, and how it is read
        pa.field("size", pa.int64()),
        pa.field("mtime", pa.int64()),  # nanoseconds
        pa.field("vertices", pa.int64()),
        pa.field("triangles", pa.int64()),  # 0: a cloud
        pa.field("watertight", pa.bool_()),
        pa.field("option", pa.string()),  # fingerprint
        pa.field("signature", pa.binary(signature_type(option).itemsize)),
        pa.field("sketch", pa.list_(pa.float16(), SKETCH_LENGTH)),
        pa.field("thumbnail", pa.binary()),  # PNG
        pa.field(CHECKSUM, pa.uint32()),  # of all the others
    ]
    return pa.schema(fields, metadata={"fsh3d.format": str(version), "fsh3d.option": option.fingerprint})


def failure_schema() -> Any:
    """Return the columns of ``failures``."""
    pa = import_installed("pyarrow")

    fields = [
        pa.field("path", pa.binary(), nullable=False, metadata=_KEY),
        pa.field("size", pa.int64()),
        pa.field("mtime", pa.int64()),
        pa.field("reason", pa.string()),
        pa.field(CHECKSUM, pa.uint32()),
    ]
    return pa.schema(fields)


def root_schema() -> Any:
    """Return the columns of ``roots``, one row a library."""
    pa = import_installed("pyarrow")

    fields = [
        pa.field("path", pa.binary(), nullable=False, metadata=_KEY),  # what the paths of its files begin with
        pa.field("location", pa.binary()),  # the folder, absolute
        pa.field(CHECKSUM, pa.uint32()),
    ]
    return pa.schema(fields)


def basis_table(basis: NDArray[np.float16]) -> Any:
    """Return the table ``basis`` of directions (d, SKETCH_LENGTH), one a row."""
    pa = import_installed("pyarrow")

    columns = {"number": pa.array(range(basis.shape[1]), pa.int32()), "direction": fixed_lists(basis.T)}
    return pa.table(columns).replace_schema_metadata({_BASIS_CHECKSUM: _basis_checksum(basis)})


def read_basis(path: str, table: Any) -> NDArray[np.float16]:
    """Return the directions (d, SKETCH_LENGTH) of Lance's table ``basis``; ``path`` is the index's, for messages.

    Raises:
        ShapeIndexError: They do not fit their checksum.
    """
    found = table.search().limit(SKETCH_LENGTH).to_arrow().sort_by("number")
    basis = vectors(found["direction"], np.float16).T
    if (table.schema.metadata or {}).get(_BASIS_CHECKSUM.encode(), b"").decode() != _basis_checksum(basis):
        raise ShapeIndexError(f"{path}: the index is damaged: the basis of its sketches does not fit its checksum")
    return basis


def _basis_checksum(basis: NDArray[np.float16]) -> str:
    return f"{zlib.crc32(np.ascontiguousarray(basis).tobytes()):08x}"
