"""Files into an index: what is new is described in worker processes and put in by and by."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, TypeVar

from fsh3d_o3d._progress import progress_bar
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors import SHDOption
from fsh3d_o3d.index.extraction import Described, DescribeFile, FileState, identity
from fsh3d_o3d.index.moves import LibraryMove, ModelRows, moved_libraries, moved_rows
from fsh3d_o3d.index.roots import LibraryRoots, inside
from fsh3d_o3d.index.rows import model_columns, moved_columns
from fsh3d_o3d.index.store import IndexStore
from fsh3d_o3d.jobs import FailedInput, Outcome, reason_line, run_tasks

Known = TypeVar("Known")

_ROWS_A_COMMIT = 512  # at most, 5 MB with thumbnails, so that many workers do not pile rows up; a choice
_SECONDS_A_COMMIT = 5.0  # between commits: the work that a kill may cost


@value
class IndexUpdate:
    """What became of files that were to be indexed."""

    added: int
    """Described and put in, or put in anew because the file has changed."""
    moved: int
    """Put in without describing them: the same content was there under another name, or with another time."""
    unchanged: int
    """In the index already."""
    failed: tuple[FailedInput, ...]
    """The others, those among them that failed before and were not tried again; in the order of the files."""
    gone: int = 0
    """Models that were removed because their files are gone, and their content is there under another name."""
    libraries: tuple[LibraryMove, ...] = ()
    """Libraries that were found to lie elsewhere than before; their models moved along."""


@dataclass
class Filling:
    """One run over some files: what is known of them, and what waits to be written."""

    store: IndexStore
    """Where rows go."""
    option: SHDOption
    """What files are described by."""
    _described: list[tuple[str, Described]] = field(default_factory=list)
    _failed: list[tuple[str, FileState, str]] = field(default_factory=list)
    _stale: set[str] = field(default_factory=set)
    _solved: set[str] = field(default_factory=set)
    _models: dict[str, FileState] = field(default_factory=dict)
    _failures: dict[str, tuple[FileState, str]] = field(default_factory=dict)
    _roots: LibraryRoots = field(default_factory=lambda: LibraryRoots("", {}))
    # By table, what rows hold of paths other than a new row would.
    _unusual: dict[str, dict[str, bytes]] = field(default_factory=dict)
    _known: frozenset[bytes] = frozenset()
    _lost: list[str] = field(default_factory=list)
    _added: int = 0
    _moved: int = 0
    _gone: int = 0
    _written: float = field(default_factory=time.monotonic)

    def run(
        self,
        paths: Sequence[str],
        describe: DescribeFile,
        *,
        workers: int,
        timeout: float,
        retry_failed: bool,
        progress: bool,
        library: str | None = None,
        moved_from: Collection[str] = (),
        run_elsewhere: Callable[..., Generator[Outcome[Any], None, None]] | None = None,
    ) -> IndexUpdate:
        """Describe what is new or has changed and write it; ``describe.known`` is filled in here.

        Paths are real (``real_file``), ``library`` (``real_folder``) is what they are below, if anything, and lay where
        ``moved_from`` says, by all its names. ``run_elsewhere`` stands in for ``run_tasks``.
        """
        self.store.require_writable()
        self.store.refresh()
        states = FileState.of_all(paths)
        moves = self._update_libraries(library, states, moved_from)
        self._load()
        reasons: dict[str, str] = {}
        todo: dict[str, FileState] = {}
        for path, state in states.items():
            if isinstance(state, str):
                reasons[path] = state
                continue
            if self._models.get(path) == state:
                if path in self._failures:
                    self._solved.add(path)
                continue
            before = self._failures.get(path)
            if before is not None and before[0] == state and not retry_failed:
                reasons[path] = before[1]
                if path in self._models:
                    self._stale.add(path)
                continue
            todo[path] = state
        describe = replace(describe, option=self.option, known=self._known)
        map_over = functools.partial(run_elsewhere or run_tasks, workers=workers, timeout=timeout)
        with progress_bar(len(todo), wanted=progress, unit="model") as bar:
            self._work(todo, describe, reasons, map_over, bar)
            if self._lost:
                # Their content was known from rows that are gone since, as two files that swapped names leave it where
                # the first was written before the second was read.
                again, self._lost = {path: todo[path] for path in self._lost}, []
                bar.total = len(todo) + len(again)
                self._work(again, replace(describe, known=frozenset()), reasons, map_over, bar)
        self._forget_moved({path for path, state in states.items() if isinstance(state, FileState)})
        return IndexUpdate(
            gone=self._gone,
            libraries=tuple(moves.values()),
            added=self._added,
            moved=self._moved,
            unchanged=len(paths) - len(reasons) - self._added - self._moved,
            failed=tuple(FailedInput(path, reasons[path]) for path in paths if path in reasons),
        )

    def _work(
        self,
        todo: dict[str, FileState],
        describe: DescribeFile,
        reasons: dict[str, str],
        map_over: Callable[..., Generator[Outcome[Any], None, None]],
        bar: Any,
    ) -> None:
        """Describe files, write what comes of it by and by, and put down why there are failures."""
        tasks = list(todo)
        # Closed whatever happens here: an interrupt must not leave processes behind.
        with closing(map_over(describe, tasks)) as outcomes:
            for outcome in outcomes:
                path = tasks[outcome.index]
                if outcome.result is None:
                    reasons[path] = reason_line(outcome.reason, path)
                    self._failed.append((path, todo[path], reasons[path]))
                else:
                    self._described.append((path, outcome.result))
                bar.update()
                self._write_if_due()
        self._write()

    def _update_libraries(
        self, library: str | None, states: Mapping[str, FileState | str], moved_from: Collection[str]
    ) -> dict[bytes, LibraryMove]:
        """Find out where the libraries of the index lie, and put down what is new of it."""
        if library is None:
            return {}
        moves: dict[bytes, LibraryMove] = {}
        rows = self._rows()
        locations = sorted(self._roots.locations.values())
        if moved_from and library not in locations:  # else it was found to have moved by now
            known = chain(map(inside, locations), map(self._roots.path, rows.stored))
            if not any(one.startswith(tuple(map(inside, moved_from))) for one in known):
                there = ", ".join(locations) or "none"
                raise ValueError(f"the index knows no library {min(moved_from)}; its libraries: {there}")
        if locations:
            moves = moved_libraries(self._roots, rows, library, states, moved_from)
        for own, move in moves.items():
            self.store.place_library(own, move.new)
        roots = self.store.roots()
        if not roots.holds(library):
            self.store.place_library(roots.new(library), library)
        return moves

    def _rows(self) -> ModelRows:
        """Read the models, and where libraries lie: after them, as another writer may have put in both."""
        values = self.store.columns(self.store.models, ["path", "size", "mtime", "identity"]).to_pydict()
        self._roots = self.store.roots()
        return ModelRows(values["path"], list(map(FileState, values["size"], values["mtime"])), values["identity"])

    def _load(self) -> None:
        failures = self.store.columns(self.store.failures, ["path", "size", "mtime", "reason"]).to_pydict()
        rows = self._rows()
        self._known = frozenset(rows.identities)
        self._models = dict(self._unique(self.store.models, rows.stored, rows.states))
        known = zip(map(FileState, failures["size"], failures["mtime"]), failures["reason"], strict=True)
        self._failures = dict(self._unique(self.store.failures, failures["path"], known))

    def _unique(self, table: Any, paths: Iterable[bytes], about: Iterable[Known]) -> Iterator[tuple[str, Known]]:
        """Yield the path of each row and what is known; of two with the same path one is removed.

        There are two where libraries came to lie inside of each other, or in the same place.
        """
        unusual = self._unusual[table.name] = {}
        seen: set[str] = set()
        twice: list[bytes] = []
        for stored, one in zip(paths, about, strict=True):
            path = self._roots.path(stored)
            if path in seen:
                twice.append(stored)
                continue
            seen.add(path)
            if stored != self._roots.stored(path):
                unusual[path] = stored
            yield path, one
        if twice:
            self.store.remove(table, sorted(twice))
            self._gone += len(twice) if table is self.store.models else 0

    def _forget_moved(self, there: Collection[str]) -> None:
        """Remove the models whose files are gone while their content is there under another name."""
        rows = self._rows()
        gone = moved_rows(self._roots, rows, there)
        if gone:
            self.store.remove(self.store.models, sorted(gone))
            self._gone += len(gone)

    def _write_if_due(self) -> None:
        waiting = len(self._described) + len(self._failed)
        if waiting >= _ROWS_A_COMMIT or (waiting and time.monotonic() - self._written > _SECONDS_A_COMMIT):
            self._write()

    def _write(self) -> None:
        """Write what waits. A path that a kill leaves in both tables is in the one whose row has the file's state."""
        store = self.store
        if self._failed:
            columns = {
                "path": [self._stored(store.failures, path) for path, _, _ in self._failed],
                "size": [state.size for _, state, _ in self._failed],
                "mtime": [state.mtime for _, state, _ in self._failed],
                "reason": [reason for _, _, reason in self._failed],
            }
            store.put(store.failures, columns)
            self._stale |= {path for path, _, _ in self._failed if path in self._models}
        self._write_models()
        self._solved |= {path for path, _ in self._described if path in self._failures}
        for table, paths in ((store.models, self._stale), (store.failures, self._solved)):
            if paths:
                store.remove(table, sorted(self._stored(table, path) for path in paths))
        self._described, self._failed, self._stale, self._solved = [], [], set(), set()
        self._written = time.monotonic()

    def _write_models(self) -> None:
        """Put in what was described and what moved, in one commit: a row may replace the one that another needs."""
        new = [(path, found) for path, found in self._described if found.signature is not None]
        moved = [(path, found) for path, found in self._described if found.signature is None]
        parts = []
        if moved:
            wanted = [identity(path, one.content) for path, one in moved]
            rows = self.store.where("identity", sorted(set(wanted)), self.store.models.schema.names)
            place = {value: index for index, value in enumerate(rows["identity"].to_pylist())}
            kept = [one for one, value in zip(moved, wanted, strict=True) if value in place]
            self._lost += [path for (path, _), value in zip(moved, wanted, strict=True) if value not in place]
            if kept:
                taken = rows.take([place[value] for value in wanted if value in place])
                paths, found = zip(*kept, strict=True)
                parts.append(moved_columns(taken, paths, found) | self._path_column(paths))
            self._moved += len(kept)
        if new:
            paths, found = zip(*new, strict=True)
            columns = model_columns(paths, found, self.option, self.store.basis)
            parts.append(columns | self._path_column(paths))
            self._added += len(new)
        if parts:
            self.store.put(self.store.models, *parts)

    def _path_column(self, paths: Iterable[str]) -> dict[str, list[bytes]]:
        return {"path": [self._stored(self.store.models, path) for path in paths]}

    def _stored(self, table: Any, path: str) -> bytes:
        """What the row of a path holds of it."""
        return self._unusual[table.name].get(path) or self._roots.stored(path)
