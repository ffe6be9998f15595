"""A library of shapes on disk that answers which of them are most like another."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal, get_args

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import printable
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.files import absolute, read_geometry_arrays
from fsh3d_o3d.geometry import geometry_arrays
from fsh3d_o3d.index.errors import ShapeIndexError
from fsh3d_o3d.index.export import export_features
from fsh3d_o3d.index.extraction import DescribeFile, Thumbnailer, describe
from fsh3d_o3d.index.filling import Filling, IndexUpdate
from fsh3d_o3d.index.pairs import near_duplicates
from fsh3d_o3d.index.pruning import prune, remove
from fsh3d_o3d.index.reranking import reranked_hits
from fsh3d_o3d.index.results import Hit, IndexedModel, IndexSummary, NearDuplicate
from fsh3d_o3d.index.roots import real_file, real_files, real_folder
from fsh3d_o3d.index.rows import Query
from fsh3d_o3d.index.search import IndexSearch
from fsh3d_o3d.index.store import IndexStore
from fsh3d_o3d.index.summary import indexed_models, summary
from fsh3d_o3d.jobs import FailedInput, run_tasks_on_ray

__all__ = ["ShapeIndex"]

Engine = Literal["local", "ray"]

_PRESETS: tuple[Callable[[], SHDOption], ...] = (SHDOption.best, SHDOption.published, SHDOption)


class ShapeIndex:
    """A folder that holds what is needed to find shapes again: no server, no pickle, safe to kill while it is written.

    Any number of processes may read and write it at once, and any number of threads may share one. What a query
    returns is of one moment, whatever is written meanwhile. Made by ``ShapeIndex.open``.

    Example:
        >>> from pathlib import Path
        >>> index = fsh.ShapeIndex.open("parts.fsh", create=True)
        >>> index.add_files(["samples/gem.stl", "samples/gem_rotated.stl", "samples/horn.off"], workers=1).added
        3
        >>> for hit in index.query("samples/gem.stl", top=2):
        ...     print(hit.rank, Path(hit.path).name, f"{hit.distance:.1f}")
        ...
        1 gem.stl 0.0
        2 gem_rotated.stl 0.2
    """

    def __init__(self, store: IndexStore, option: SHDOption) -> None:
        self._store = store
        self._search = IndexSearch(store, option)
        self._option = option

    @classmethod
    def open(cls, path: str | os.PathLike[str], create: bool = False, *, option: SHDOption | None = None) -> ShapeIndex:
        """Open an index.

        Args:
            path: Its folder; or a name in object storage, like ``s3://bucket/parts.fsh``, with the credentials and the
                endpoint of the environment (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, …).
            create: Make it where there is none.
            option: What its models are described by. None: what the index was made with, ``SHDOption.best()`` for a
                new one.

        Raises:
            FileNotFoundError: There is none.
            ShapeIndexError: The folder holds something else, a damaged index, one made by a newer version, or one made
                with another option.
            OSError: It cannot be read, or not made.

        Example:
            >>> len(fsh.ShapeIndex.open("parts.fsh"))
            3
        """
        name = absolute(path)
        if option is not None and not isinstance(option, SHDOption):
            raise TypeError(f"option must be an SHDOption, got {type(option).__name__}")
        store = IndexStore.open(name, (option or SHDOption.best()) if create else None)
        made_with = store.metadata.get("fsh3d.option", "")
        known = [option] if option is not None else [preset() for preset in _PRESETS]
        for candidate in known:
            if candidate.fingerprint == made_with:
                return cls(store, candidate)
        which = "the option given" if option is not None else "any option that has a name: open it with the same option"
        raise ShapeIndexError(f"{name}: the index was not made with {which}")

    @property
    def path(self) -> str:
        """The folder, absolute, or its name in object storage."""
        return self._store.path

    @property
    def option(self) -> SHDOption:
        """What its models are described by."""
        return self._option

    def __repr__(self) -> str:
        return f"{type(self).__name__}({printable(self.path)!r})"  # not how many models: its folder may be gone

    def __len__(self) -> int:
        return self._store.latest().count

    def __contains__(self, path: object) -> bool:
        if not isinstance(path, (str, os.PathLike)):
            return False
        wanted = self._store.roots().all_stored(real_file(path))
        return bool(self._store.where("path", wanted, ["path"]).num_rows)

    def __iter__(self) -> Iterator[str]:
        """Yield the paths of all models in order.

        Example:
            >>> [Path(path).name for path in index]
            ['gem.stl', 'gem_rotated.stl', 'horn.off']
        """
        return (model.path for model in self.models())

    def models(self) -> Iterator[IndexedModel]:
        """Yield what is known of each model, in the order of their paths.

        Example:
            >>> [(Path(model.path).name, model.triangles) for model in index.models() if model.watertight]
            [('gem.stl', 94), ('gem_rotated.stl', 94), ('horn.off', 3784)]
        """
        yield from indexed_models(self._store)

    def summary(self) -> IndexSummary:
        """Return how many models there are, of which libraries, and what the index takes.

        Example:
            >>> index.summary().models, index.summary().failures
            (3, 0)
        """
        return summary(self._store)

    def export_features(self, target: str | os.PathLike[str]) -> int:
        """Write the features of all models to a file for other programs; returns how many that were.

        ``.npz``: ``features`` (n, d) float32 and ``paths`` (n,), bytes of UTF-8, with ``shape``, ``metric`` and
        ``fingerprint`` of the option; no pickle. ``.parquet``: columns ``path`` and ``feature``. In both, bytes of a
        name that are not UTF-8 are escaped. The file is complete or not there.

        Raises:
            ValueError: The name ends in something else.
            OSError: The file cannot be written.
            ShapeIndexError: The index is damaged.

        Example:
            >>> index.export_features("features.npz")
            3
            >>> np.load("features.npz")["features"].shape
            (3, 3600)
        """
        name = os.fsdecode(target)
        if not name.lower().endswith((".npz", ".parquet")):
            raise ValueError(f"features are written to .npz or .parquet, got {name!r}")
        return self._store.reading(lambda models: export_features(models, self._store.roots(), self._option, name))

    def add_files(
        self,
        paths: Iterable[str | os.PathLike[str]],
        workers: int | None = 2,
        *,
        timeout: float = 300.0,
        retry_failed: bool = False,
        thumbnail: Thumbnailer | None = None,
        memory_limit: int = 8 * 2**30,
        progress: bool = False,
        engine: Engine = "local",
        address: str | None = None,
        library: str | os.PathLike[str] | None = None,
        moved_from: str | os.PathLike[str] | None = None,
    ) -> IndexUpdate:
        """Put files in, or put them in anew where they have changed.

        A file of known size and time of change is not read; one of known content is not described again. A model whose
        file is gone while its content is there under another name is removed: it was renamed. Each of the others is
        read and described in a worker process, at its own risk: what kills the process, takes too long or changes
        meanwhile is listed, kept in mind, and not tried again until it changes. Rows are written every few seconds, so
        a kill costs no more than that. As always with processes, a script that calls this does so below
        ``if __name__ == "__main__":``.

        Args:
            paths: Meshes and point clouds in any format that is read; also in object storage.
            workers: Processes with one thread each; None: one for each core that this process may use.
            timeout: Seconds that one file may take.
            retry_failed: Try again what failed before.
            thumbnail: Draws a picture of each, as ``fsh3d_o3d.report.library_thumbnail`` does; None: none.
            memory_limit: Bytes that one file may take.
            progress: Show a bar, on a terminal or in a notebook.
            engine: ``"local"``: on this machine. ``"ray"``: on a Ray cluster, every machine of which sees the files
                under the same paths and has this package; rows come back here and are written here, the same as with
                the local engine. Needs the extra ``ray``.
            address: Of the Ray cluster, as ``ray.init`` takes it; None: one of ``workers`` processors is started on
                this machine.
            library: A folder that the files are below. The index keeps their names relative to it, and recognises it
                by its content when it is gone and given under another name.
            moved_from: Where the library was before, or a folder that several were in, so that it need not be
                recognised.

        Raises:
            ValueError: There was no library where ``moved_from`` says.
            ModuleNotFoundError: Ray is asked for and not installed.
            ConnectionError: There is no Ray at the address.
            OSError: The index cannot be written: read-only, or the disk is full. It then is as after the last write.
            RuntimeError: The worker processes do not start, or Ray lost a part of the work.

        Example:
            >>> update = index.add_files(["samples/gem.stl"])
            >>> update.added, update.unchanged  # known already: not read again
            (0, 1)
        """
        if engine not in get_args(Engine):
            raise ValueError(f"engine must be 'local' or 'ray', got {engine!r}")
        if address is not None and engine != "ray":
            raise ValueError("address is of a Ray cluster: give engine='ray' with it")
        cores = len(os.sched_getaffinity(0)) if workers is None else workers
        number = check.integer(cores, "workers", minimum=1, maximum=1024)
        limit = check.memory_limit(memory_limit, "memory_limit")
        if moved_from is not None and library is None:
            raise ValueError("moved_from says where a library was: give library with it")
        names = list(dict.fromkeys(real_files(paths)))
        update = Filling(self._store, self._option).run(
            names,
            DescribeFile(self._option, thumbnail=thumbnail, memory_limit=limit),
            workers=number,
            timeout=check.seconds(timeout, "timeout"),
            retry_failed=retry_failed,
            progress=progress,
            library=None if library is None else real_folder(library),
            moved_from=() if moved_from is None else {absolute(moved_from), real_folder(moved_from)},
            run_elsewhere=functools.partial(run_tasks_on_ray, address=address) if engine == "ray" else None,
        )
        if update.added or update.moved or update.gone:
            self._search.index(moved=self._store.tidy())
        return update

    def prune(
        self, folder: str | os.PathLike[str] | None = None, *, on_kept: Callable[[FailedInput], None] | None = None
    ) -> int:
        """Remove models, and failures, whose files are gone; returns how many models.

        Gone is what the system says is not there. What it gives no answer about (a folder without permission, a disk
        that fails) is kept.

        Args:
            folder: Only those below it. It must be there, unless it is a library of the index: one that is gone, or
                empty as where a disk is not mounted, is forgotten where it is named, and kept where it is not.
            on_kept: Called with each folder whose files were kept though they were not seen. None: they are warned of.

        Raises:
            OSError: The folder, or its bucket, is not there, a storage does not answer, or the index cannot be written.

        Example:
            >>> index.prune()  # every file is still there
            0
        """
        return prune(self._store, folder, on_kept or _warn_of)

    def remove(self, paths: Iterable[str | os.PathLike[str]]) -> int:
        """Forget files, whether they are there or not; returns how many models that were.

        Args:
            paths: Files, and folders for all that is below them.

        Raises:
            OSError: The index cannot be written.

        Example:
            >>> index.remove(["samples/horn.off"]), "samples/horn.off" in index
            (1, False)
        """
        return remove(self._store, [paths] if isinstance(paths, (str, os.PathLike)) else paths)

    def failures(self) -> tuple[FailedInput, ...]:
        """Return the files that could not be described, and why.

        Example:
            >>> [(failed.path, failed.reason) for failed in index.failures()]
            []
        """
        table = self._store.reading(lambda failures: failures.checked(), "failures").to_pydict()
        pairs = sorted(zip(table["path"], table["reason"], strict=True))
        roots = self._store.roots()
        return tuple(FailedInput(roots.path(stored), reason) for stored, reason in pairs)

    def query(self, geometry_or_path: Any, top: int = 10, rerank: int = 100) -> tuple[Hit, ...]:
        """Return the models most like a shape, best first; the shape itself among them if it is in the index.

        Args:
            geometry_or_path: Anything ``compute_shd_feature`` takes, or a file.
            top: At most this many hits.
            rerank: This many candidates (at least ``top``) are aligned with the query and ranked by a mixture of both
                distances; 0: hits are ranked by their features, and aligned to tell their rotations.

        Raises:
            TypeError: Neither a geometry nor a path.
            GeometryError: It cannot be read or described.
            ShapeIndexError: The index is damaged.

        Example:
            >>> mesh = fsh.read_geometry("samples/gem.stl").scale(3.0, center=(0, 0, 0))
            >>> best, second = index.query(mesh, top=2)
            >>> best.rank, best.transformation.shape  # that places the hit as the query lies
            (1, (4, 4))
        """
        top = check.integer(top, "top", minimum=1, maximum=10**6)
        rerank = check.integer(rerank, "rerank", minimum=0, maximum=10**6)
        if isinstance(geometry_or_path, (str, bytes, os.PathLike)):
            geometry = read_geometry_arrays(os.fsdecode(geometry_or_path))
        else:
            geometry = geometry_arrays(geometry_or_path)[0]
        query = Query.of(describe(geometry, self._option), self._store.basis)
        return self._store.reading(
            lambda models: reranked_hits(models, self._search, query, self._store.roots, top, rerank)
        )

    def near_duplicates(self, limit: float = 0.05) -> tuple[NearDuplicate, ...]:
        """Return the pairs of models whose features are at most ``limit`` apart, closest first.

        All pairs are compared by short sketches, which lose none that is this near: a minute or so for 10⁵ models, and
        four times as long for twice as many. Each pair is then aligned as it is and mirrored: half a millisecond.

        Example:
            >>> [(Path(pair.first).name, Path(pair.second).name) for pair in index.near_duplicates()]
            [('gem.stl', 'gem_rotated.stl')]
        """
        limit = check.number(limit, "limit", minimum=0, maximum=2)
        return self._store.reading(
            lambda models: near_duplicates(models, self._search, self._option, self._store.roots().path, limit)
        )


def _warn_of(kept: FailedInput) -> None:
    warnings.warn(printable(f"{kept.path}: {kept.reason}"), stacklevel=3)
