"""A library of shapes on disk or in object storage that answers which of them are most like another."""

from __future__ import annotations

from fsh3d_o3d.index.codec import decoded, encoded
from fsh3d_o3d.index.extraction import Described, FileState, describe
from fsh3d_o3d.index.filling import IndexUpdate
from fsh3d_o3d.index.library_files import LibraryScan, is_folder, library_files, scan_library
from fsh3d_o3d.index.moves import LibraryMove
from fsh3d_o3d.index.results import IndexedModel, IndexSummary, NearDuplicate
from fsh3d_o3d.index.roots import real_folder
from fsh3d_o3d.index.rows import Query, model_columns
from fsh3d_o3d.index.search import EXACT_BELOW, IndexSearch
from fsh3d_o3d.index.shape_index import Hit, ShapeIndex, ShapeIndexError
from fsh3d_o3d.index.store import IndexStore

__all__ = [
    "LibraryMove",
    "IndexUpdate",
    "NearDuplicate",
    "IndexSummary",
    "IndexedModel",
    "Described",
    "EXACT_BELOW",
    "FileState",
    "Hit",
    "IndexSearch",
    "IndexStore",
    "LibraryScan",
    "Query",
    "ShapeIndex",
    "ShapeIndexError",
    "decoded",
    "describe",
    "encoded",
    "is_folder",
    "library_files",
    "model_columns",
    "real_folder",
    "scan_library",
]
