"""What an index holds, for other programs: features with their paths as NumPy or Parquet."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._atomic import replacement
from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._printable import encodable
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.index.checksums import require_checksums
from fsh3d_o3d.index.columns import fixed_lists
from fsh3d_o3d.index.roots import LibraryRoots
from fsh3d_o3d.index.rows import stored_rows
from fsh3d_o3d.index.version import TableVersion


def export_features(models: TableVersion, roots: LibraryRoots, option: SHDOption, target: str) -> int:
    """Write the features of all models; see ``ShapeIndex.export_features``."""
    write = _write_numpy if Path(target).suffix.lower() == ".npz" else _write_parquet
    with replacement(target) as file:
        return write(file, models, roots, option)


def _batches(
    models: TableVersion, roots: LibraryRoots, option: SHDOption
) -> Iterator[tuple[list[str], NDArray[np.float32]]]:
    """Yield paths, as text that any encoding can hold, and features (n, d), some thousand rows at a time."""
    for table in models.batches(models.table.schema.names):
        require_checksums(table, models.path)
        paths = [encodable(roots.path(stored)) for stored in table["path"].to_pylist()]
        yield paths, stored_rows(table["signature"], option, models.path).features


def _write_numpy(target: BinaryIO, models: TableVersion, roots: LibraryRoots, option: SHDOption) -> int:
    """Features go into the archive as they come: of a million models they would not fit the memory."""
    length = option.feature_shape[0] * option.feature_shape[1]
    paths: list[bytes] = []
    with zipfile.ZipFile(target, "w") as archive:
        with archive.open("features.npy", "w", force_zip64=True) as file:
            header = {"descr": "<f4", "fortran_order": False, "shape": (models.count, length)}
            np.lib.format.write_array_header_2_0(file, header)
            for names, features in _batches(models, roots, option):
                paths += [name.encode("utf-8") for name in names]
                file.write(np.ascontiguousarray(features, "<f4").tobytes())
        about = {
            "paths": np.array(paths, dtype=f"S{max(map(len, paths), default=1)}"),
            "shape": np.array(option.feature_shape),
            "metric": np.array(option.metric),
            "fingerprint": np.array(option.fingerprint),
        }
        for name, array in about.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    return len(paths)


def _write_parquet(target: BinaryIO, models: TableVersion, roots: LibraryRoots, option: SHDOption) -> int:
    pa, parquet = import_installed("pyarrow"), import_installed("pyarrow.parquet")
    length = option.feature_shape[0] * option.feature_shape[1]
    about = {"shape": "{} {}".format(*option.feature_shape), "metric": option.metric, "fingerprint": option.fingerprint}
    fields = [pa.field("path", pa.string()), pa.field("feature", pa.list_(pa.float32(), length))]
    number = 0
    with parquet.ParquetWriter(target, pa.schema(fields, metadata=about)) as writer:
        for names, features in _batches(models, roots, option):
            writer.write_table(pa.table({"path": names, "feature": fixed_lists(features)}, schema=writer.schema))
            number += len(names)
    return number
