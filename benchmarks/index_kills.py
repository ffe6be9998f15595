"""Endurance of an index: ``fsh3d index`` killed again and again while it fills one.

    python -m benchmarks.index_kills --models DIR [--kills 30] [--seed 0] [--writers 1] [--output DIR]

Each writer is ended by SIGKILL, and its workers with it, at a moment drawn uniformly from the
time that an undisturbed run takes, start-up included. Between kills files and folders of the library are renamed,
moved, swapped, copied and replaced. After every kill the index must open, hold all that it held and that is still
right, no path twice, and answer a query; then it is filled on. When a writer has come to its end one more, undisturbed,
follows: then each file that can be read must have one row with its content, the others must be listed with the reason
that they had in a first, undisturbed run, there must be nothing else, and a new index is begun.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks._changing_library import ChangingLibrary, Identity
from fsh3d_o3d.index import ShapeIndex, ShapeIndexError, library_files

Stage = Literal["start-up", "filling", "end"]

_COMMAND = (sys.executable, "-c", "import sys; from fsh3d_o3d.cli import main; sys.exit(main())", "index")
_WORKER = b"fsh3d_o3d.jobs.worker_pool"  # in its command line
_LOOK = 0.05  # seconds between two looks at the writers
_SAME = 0.05  # distance of a model from its stored self: rounding makes a hundredth
_PATIENCE = 20.0  # times an undisturbed run, before a writer counts as one that hangs


@dataclass(frozen=True)
class Content:
    """What an index holds."""

    made: bool
    """Whether there is an index; else a kill came before its tables were there."""
    models: frozenset[tuple[str, str]]
    """Files described, and the SHA-256 of their content."""
    failures: frozenset[tuple[str, str]]
    """Files not described, and why."""
    problems: tuple[str, ...]
    """What must not be."""


@dataclass(frozen=True)
class Kill:
    """One kill, and what was found after it."""

    stage: Stage
    """No worker process yet, workers at work, or workers gone and the last rows being written."""
    seconds: float
    """After the start of the writer."""
    made: bool
    """Whether there was an index to open."""
    models: int
    """In the index afterwards."""
    lost: float | None
    """Seconds of describing since the last commit; None with several writers, whose commits look alike."""
    problems: tuple[str, ...]
    """Empty if all was well."""
    changes: tuple[str, ...] = ()
    """Of the library, before the writer was started."""


@dataclass
class Report:
    """What came of all kills."""

    models: int
    """That an undisturbed run indexes."""
    failures: int
    """That it lists."""
    undisturbed_seconds: float
    """How long it takes."""
    writers: int
    """At once."""
    kills: list[Kill] = field(default_factory=list)
    """One by one."""
    completed: int = 0
    """Indices that were filled to the end, each found to hold what it should unless ``problems`` says otherwise."""
    problems: list[str] = field(default_factory=list)
    """All, of kills and of complete indices."""

    def require_end(self, code: int, log: Path) -> None:
        """Note a writer that came to an end, but not to a good one."""
        if code not in (0, 1):
            self.problems.append(f"a writer ends with {code}: {log.read_text(errors='replace')[-300:]}")

    def figures(self) -> dict[str, Any]:
        """Return the figures that count."""
        lost = [kill.lost for kill in self.kills if kill.stage == "filling" and kill.lost is not None]
        return {
            "kills": len(self.kills),
            **{stage: sum(kill.stage == stage for kill in self.kills) for stage in ("start-up", "filling", "end")},
            "before there was an index": sum(not kill.made for kill in self.kills),
            "opened every time": not any("does not open" in text for text in self.problems),
            "duplicates": sum("twice" in text for text in self.problems),
            "lost models": sum("lost" in text for text in self.problems),
            "work lost, median s": round(statistics.median(lost), 2) if lost else None,
            "work lost, most s": round(max(lost), 2) if lost else None,
            "changes of the library": sum(len(kill.changes) for kill in self.kills),
            "indices completed": self.completed,
            "problems": len(self.problems),
        }


@dataclass
class _Writer:
    """A running ``fsh3d index``, when it is to be killed, and how far it was seen to be."""

    process: subprocess.Popen[bytes]
    started: float
    moment: float
    filling_since: float | None = None
    stage: Stage = "start-up"

    @classmethod
    def start(cls, command: Sequence[str], after: float, log: Path) -> _Writer:
        with log.open("ab") as errors:
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True)
        return cls(process, time.time(), time.time() + after)

    def look(self) -> None:
        """Find out how far it is."""
        if _has_workers(self.process.pid):
            self.filling_since, self.stage = self.filling_since or time.time(), "filling"
        elif self.stage == "filling":
            self.stage = "end"

    def kill(self) -> None:
        """End the whole group."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def examine(index: str, before: frozenset[tuple[str, str]] = frozenset()) -> Content:
    """Open an index and return what it holds and what is wrong with it; ``before`` is what it must hold."""
    try:
        found = ShapeIndex.open(index)
    except FileNotFoundError as error:
        return Content(False, frozenset(), frozenset(), (f"does not open: {error}",) if before else ())
    except (ShapeIndexError, OSError) as error:
        # Tables are made one after the other, models last: a kill between leaves a folder that the next run completes.
        half_made = not before and not Path(index, "models.lance").exists()
        return Content(False, frozenset(), frozenset(), () if half_made else (f"does not open: {error}",))
    problems: list[str] = []
    store = found._store
    listed = {}
    for name, table in (("models", store.models), ("failures", store.failures)):
        columns = store.columns(table, ["path", "content"] if name == "models" else ["path"]).to_pydict()
        columns["path"] = list(map(store.roots().path, columns["path"]))
        listed[name] = columns
        twice = [path for path, count in Counter(columns["path"]).items() if count > 1]
        problems += [f"twice in the {name}: {path}" for path in twice]
    paths = listed["models"]["path"]
    models = frozenset(zip(paths, (content.hex() for content in listed["models"]["content"]), strict=True))
    if len(found) != len(paths):
        problems.append(f"its length is {len(found)}, but there are {len(paths)} rows")
    problems += [f"lost: {path}" for path, _ in sorted(before - models)]
    if before & models:
        path = min(path for path, _ in before & models)
        if not _finds(found, path):
            problems.append(f"a query of {path} does not find it")
    failures = frozenset((failed.path, failed.reason) for failed in found.failures())
    return Content(True, models, failures, tuple(problems))


def _finds(index: ShapeIndex, path: str) -> bool:
    """Whether a file that is in an index is found there; of several with the same content any will do."""
    hits = index.query(path, top=1, rerank=0)
    return len(hits) == 1 and hits[0].distance <= _SAME


def run(models: str, kills: int, *, seed: int = 0, writers: int = 1, arguments: Sequence[str] = ()) -> Report:
    """Kill writers of a copy of a library, ``writers`` at once, and say what came of it.

    ``arguments`` are further ones of ``fsh3d index``.

    Raises:
        RuntimeError: There is nothing to index, or the undisturbed run fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        draw = random.Random(seed)
        library = ChangingLibrary(models, Path(folder, "library"), draw)
        command = [*_COMMAND, "--quiet", "--prune", *arguments, library.path]
        index, log = f"{folder}/undisturbed", Path(folder, "errors")
        begin = time.perf_counter()
        code = _undisturbed([*command, index], log, None)
        seconds = time.perf_counter() - begin
        found = examine(index)
        if code not in (0, 1) or found.problems or not found.models:
            raise RuntimeError(f"an undisturbed run ends with {code}: {log.read_text()[-500:]} {found.problems}")
        identities = library.identities()
        reasons = {identities[path]: reason for path, reason in found.failures}
        report = Report(len(found.models), len(found.failures), seconds, writers)
        report.problems += [f"undisturbed: {text}" for text in _differences(found, _expected(library, reasons))]
        library.keep_back(Path(folder, "spare"))
        while len(report.kills) < kills:
            index = f"{folder}/index{report.completed}"
            _one_index([*command, index], kills, library, draw, report, log)
            expected = _expected(library, reasons)
            complete = examine(index, expected.models)
            report.problems += [f"complete index: {text}" for text in _differences(complete, expected)]
            report.completed += 1
            shutil.rmtree(index)
    return report


def _expected(library: ChangingLibrary, reasons: Mapping[Identity, str]) -> Content:
    """What an index of a library should hold; ``reasons`` why some contents cannot be read."""
    files = library.identities()
    models = frozenset((path, identity[0]) for path, identity in files.items() if identity not in reasons)
    failures = frozenset((path, reasons[identity]) for path, identity in files.items() if identity in reasons)
    return Content(True, models, failures, ())


def _one_index(
    command: Sequence[str], kills: int, library: ChangingLibrary, draw: random.Random, report: Report, log: Path
) -> None:
    """Fill one index, with kills and changes, until a writer has come to its end, and once more."""
    there: frozenset[tuple[str, str]] = frozenset()
    while len(report.kills) < kills:
        changes = tuple(library.change())
        # What is right must stay; a row of a file that has changed may go.
        there &= {(path, identity[0]) for path, identity in library.identities().items()}
        limit = time.time() + _PATIENCE * report.writers * report.undisturbed_seconds + 60
        moments = [draw.uniform(0, report.undisturbed_seconds) for _ in range(report.writers)]
        running = [_Writer.start(command, moment, log) for moment in moments]
        ended = False
        try:
            while running:
                time.sleep(_LOOK)
                for writer in list(running):
                    writer.look()
                    code = writer.process.poll()
                    if code is not None:
                        ended = True
                        report.require_end(code, log)
                    elif time.time() > limit:
                        report.problems.append("a writer hangs")
                        writer.kill()
                    elif time.time() > writer.moment and len(report.kills) < kills:
                        there = _kill(writer, command[-1], there, changes, report)
                        changes = ()
                    else:
                        continue
                    running.remove(writer)
        finally:
            for writer in running:
                writer.kill()
        if ended:
            break
    report.require_end(_undisturbed(command, log, _PATIENCE * report.undisturbed_seconds + 60), log)


def _undisturbed(command: Sequence[str], log: Path, patience: float | None) -> int:
    with log.open("ab") as errors:
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=errors, timeout=patience, check=False)
    return done.returncode


def _kill(
    writer: _Writer, index: str, before: frozenset[tuple[str, str]], changes: tuple[str, ...], report: Report
) -> frozenset[tuple[str, str]]:
    """Kill a writer, put what is found into the report, and return the models that are there."""
    writer.kill()
    now = time.time()
    lost = None
    if report.writers == 1:
        last = max((path.stat().st_mtime for path in Path(index).glob("*.lance/_versions/*")), default=0.0)
        lost = 0.0 if writer.filling_since is None else max(0.0, now - max(last, writer.filling_since))
    found = examine(index, before)
    kill = Kill(writer.stage, now - writer.started, found.made, len(found.models), lost, found.problems, changes)
    report.kills.append(kill)
    number = len(report.kills)
    report.problems += [f"after kill {number}: {text}" for text in found.problems]
    about = f"kill {number}: {kill.stage}, {kill.seconds:.1f} s, {kill.models} models after {len(changes)} changes"
    print(about, *kill.problems, flush=True)
    return found.models


def _differences(found: Content, expected: Content) -> list[str]:
    """What a complete index has and should not have, or the other way round."""
    missing, unexpected = expected.models - found.models, found.models - expected.models
    problems = [*found.problems, *(f"missing, or not its content: {path}" for path, _ in sorted(missing))]
    problems += [f"not expected: {path}" for path, _ in sorted(unexpected)]
    if found.failures != expected.failures:
        problems.append(f"other failures: {sorted(found.failures ^ expected.failures)[:3]}")
    return problems


def _has_workers(writer: int) -> bool:
    """Whether a process has started one that describes files."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[1])
            if parent == writer and _WORKER in (process / "cmdline").read_bytes():
                return True
        except OSError:  # noqa: PERF203 - ended meanwhile
            continue
    return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it, print the figures, write ``index_kills.json``; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.index_kills", description="Kill fsh3d index.")
    parser.add_argument("--models", required=True, metavar="DIR", help="library")
    parser.add_argument("--kills", type=int, default=30, metavar="N", help="how many (30)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the moments (0)")
    parser.add_argument("--writers", type=int, default=1, metavar="N", help="that fill one index at once (1)")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for index_kills.json")
    options, rest = parser.parse_known_args(arguments)
    if next(library_files(options.models), None) is None:
        parser.error("there are no models")
    report = run(options.models, options.kills, seed=options.seed, writers=options.writers, arguments=rest)
    for name, value in [*report.figures().items(), *(("problem", text) for text in report.problems)]:
        print(f"{name}: {value}")
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        document = json.dumps({"figures": report.figures(), **asdict(report)}, indent=1)
        (options.output / "index_kills.json").write_text(document + "\n", encoding="utf-8")
    return 1 if report.problems else 0


if __name__ == "__main__":
    sys.exit(main())
