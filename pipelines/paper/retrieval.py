"""Section 4.4 and Fig. 11 of the paper: SHD and CPSHD, each on the equiangular grid (ESH) and on Fibonacci (FSH3D).

The paper finds both descriptors better on the Fibonacci grid, most for chairs and knives, least for balls, blocks and
beds. Here: precision-recall curves, first tier and mean average precision on a classified library, the classes that it
names, and whether the difference is more than chance: a paired test over queries that flips signs at random.

    python pipelines/paper/retrieval.py --models DIR --classification FILE [--cpshd] [--full]

Without a library, the samples stand in: that shows the script, not the result. CPSHD needs closed surfaces of genus 0;
all others are carved into one first, and mapping takes seconds a model. Descriptors are cached: a run that was stopped
goes on where it was.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from _common import parser, plt, run, save_figure, save_results, table

import fsh3d_o3d as fsh
from fsh3d_o3d.closing import prepare_closed
from fsh3d_o3d.descriptors import CPSHDDescriptor, CPSHDOption, SHDDescriptor, on_equiangular_grid
from fsh3d_o3d.evaluation import RECALL_LEVELS, find_models, read_classification, retrieval_metrics
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.jobs import Descriptor, extract_descriptors

SAMPLES = Path(__file__).parents[2] / "samples"
TOY = {
    "stone": ("bennu_like", "bennu_like_low"),
    "gem": ("gem", "gem_rotated", "stone_degree8", "bumpy_ellipsoid"),
    "star": ("starfish", "starfish_posed", "spiky_star"),
}
NAMED = ("ball", "block", "bed", "chair", "knife")  # words in the names of classes


@dataclass(frozen=True)
class Joined:
    """Several descriptors one after the other, of surfaces that are closed once for all of them."""

    parts: tuple[CPSHDDescriptor, ...]
    """What is described."""
    cells: int
    """At which other models are closed."""

    @property
    def fingerprint(self) -> str:
        """That of all parts."""
        return f"joined {self.cells} " + " ".join(part.fingerprint for part in self.parts)

    def describe(self, geometry: MeshArrays | PointArrays) -> np.ndarray:
        """Return the descriptors in a row."""
        surface = prepare_closed(geometry, cells_per_side=self.cells).mesh
        return np.concatenate([part.describe(surface) for part in self.parts])

    def distances(self, queries: np.ndarray, others: np.ndarray, *, progress: bool = False) -> np.ndarray:
        """Refuse: the parts are compared one by one."""
        raise NotImplementedError


def per_query(distances: np.ndarray, labels: np.ndarray, scored: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the average precision and the first tier of every query that is scored."""
    precision, tier = [], []
    for query in np.flatnonzero(scored):
        order = np.argsort(distances[query], kind="stable")
        relevant = labels[order[order != query]] == labels[query]
        count = int(relevant.sum())
        precision.append((np.cumsum(relevant) / np.arange(1, len(relevant) + 1))[relevant].mean())
        tier.append(relevant[:count].mean())
    return np.array(precision), np.array(tier)


def chance(first: np.ndarray, second: np.ndarray, seed: int) -> float:
    """Return the share of random sign flips of the paired differences whose mean is as far from 0 as theirs."""
    difference = second - first
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (10_000, len(difference)))
    means = np.abs(signs @ difference)
    return float((np.count_nonzero(means >= abs(difference.sum()) * (1 - 1e-12)) + 1) / (len(means) + 1))


def toy_classification(folder: Path) -> Path:
    """Write a classification of the samples."""
    lines = ["PSB 1", f"{len(TOY)} {sum(map(len, TOY.values()))}"]
    for name, models in TOY.items():
        lines += ["", f"{name} 0 {len(models)}", *models]
    path = folder / "samples.cla"
    path.write_text("\n".join(lines), encoding="ascii")
    return path


def library(options: argparse.Namespace) -> tuple[list[Path], np.ndarray, set[str]]:
    """Return files, the full name of each one's class, and the classes that are not scored."""
    with tempfile.TemporaryDirectory() as folder:
        file = options.classification or toy_classification(Path(folder))
        classification = read_classification(file)
    files = find_models(options.models or SAMPLES, classification.models)
    names = np.array([classification.classes[label].full_name for label in classification.labels])
    known = np.array([model in files.paths for model in classification.models])
    kept = np.isin(names, np.unique(names)[:: options.every]) & known  # whole classes, so that tiers keep their meaning
    paths = [Path(files.paths[classification.models[place]]) for place in np.flatnonzero(kept)]
    return paths, names[kept], {group.full_name for group in classification.classes if group.miscellaneous}


def described(
    paths: list[Path], options: argparse.Namespace
) -> Iterator[tuple[str, Descriptor, np.ndarray, np.ndarray]]:
    """Yield method, descriptor, its values and the places of the models that could be described."""
    published = fsh.SHDOption.published()
    methods: dict[str, Descriptor] = {
        "SHD-ESH": SHDDescriptor(on_equiangular_grid(published)),
        "SHD-FSH3D": SHDDescriptor(published),
    }
    for name, descriptor in methods.items():
        done = extract_descriptors(paths, descriptor, workers=options.workers, progress=True)
        yield name, descriptor, done.descriptors, done.indices
    if options.cpshd:
        balanced = CPSHDOption()
        conformal = dataclasses.replace(balanced, map=dataclasses.replace(balanced.map, area_weight=0))
        parts = (
            CPSHDDescriptor(on_equiangular_grid(conformal)),
            CPSHDDescriptor(conformal),
            CPSHDDescriptor(on_equiangular_grid(balanced)),
            CPSHDDescriptor(balanced),
        )
        joined = Joined(parts, options.cells)
        done = extract_descriptors(paths, joined, workers=options.workers, progress=True)
        for failed in done.failed:
            print(f"{Path(failed.path).name}: {failed.reason}")
        names = ("CPSHD-ESH", "CPSHD-FSH3D", "CPSHD, balanced map-ESH", "CPSHD, balanced map-FSH3D")
        for name, part, values in zip(names, parts, np.split(done.descriptors, len(parts), axis=1), strict=True):
            yield name, part, values, done.indices


def words(name: str) -> set[str]:
    """Return the words of a class's own name."""
    return set(name.rsplit("/", 1)[-1].split("_"))


def main() -> None:
    """Describe, rank, test, draw."""
    arguments = parser(__doc__, "retrieval")
    arguments.add_argument("--models", type=Path, help="folder of models (default: the samples)")
    arguments.add_argument("--classification", type=Path, help="a .cla file")
    arguments.add_argument("--cpshd", action="store_true", help="the conformal descriptor as well")
    arguments.add_argument("--cells", type=int, default=32, help="at which other models are closed for it")
    arguments.add_argument("--every", type=int, help="take every so manieth class (default: all; without --full, 3)")
    arguments.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = arguments.parse_args()
    if (options.models is None) != (options.classification is None):
        arguments.error("give both --models and --classification")
    if options.every is not None and options.every < 1:
        raise ValueError(f"--every must be at least 1, got {options.every}")
    if options.every is None:
        options.every = 1 if options.full or options.models is None else 3
    paths, labels, miscellaneous = library(options)
    results: dict[str, dict[str, Any]] = {}
    scores, curves, rows = {}, {}, []
    for name, descriptor, values, places in described(paths, options):
        distances = descriptor.distances(values, values)
        own = labels[places]
        metrics = retrieval_metrics(distances, own, unscored=miscellaneous)
        size = {label: int(np.count_nonzero(own == label)) for label in np.unique(own)}
        scored = np.array([size[label] > 2 and label not in miscellaneous for label in own])
        precision, tier = per_query(distances, own, scored)
        scores[name] = (places[scored], own[scored], precision, tier)
        named = {word: np.array([word in words(label) for label in own[scored]]) for word in NAMED}
        results[name] = {
            "models": len(own),
            "failed": len(paths) - len(own),
            "micro": dataclasses.asdict(metrics.micro),
            "mean_average_precision": float(precision.mean()),
            "named_classes": {
                word: {"queries": int(these.sum()), "first_tier": float(tier[these].mean())}
                for word, these in named.items()
                if these.any()
            },
        }
        curves[name] = metrics.precision_recall
        micro = metrics.micro
        figures = (micro.nearest_neighbor, micro.first_tier, micro.second_tier, micro.dcg, float(precision.mean()))
        rows.append((name, len(own), *(100 * figure for figure in figures)))
    print(table(("%", "models", "NN", "first tier", "second tier", "DCG", "mAP"), rows))
    for name in [name for name in scores if name.endswith("-ESH")]:
        kind = name.removesuffix("-ESH")
        esh, fsh3d = scores[name], scores[f"{kind}-FSH3D"]
        _, left, right = np.intersect1d(esh[0], fsh3d[0], return_indices=True)
        compared = {}
        for place, metric in ((2, "mean_average_precision"), (3, "first_tier")):
            first, second = esh[place][left], fsh3d[place][right]
            difference = float((second - first).mean())
            compared[metric] = {"fsh3d_minus_esh": difference, "chance": chance(first, second, options.seed)}
            shown = f"{100 * difference:+.2f} % (p = {compared[metric]['chance']:.2g})"
            print(f"{kind}, FSH3D over ESH, {metric.replace('_', ' ')}: {shown}")
        results[f"{kind}: FSH3D over ESH"] = compared
        for word, values in results[name]["named_classes"].items():
            other = results[f"{kind}-FSH3D"]["named_classes"][word]["first_tier"]
            tiers = f"{100 * values['first_tier']:.1f} -> {100 * other:.1f} %"
            print(f"  {word}: first tier {tiers}, {values['queries']} queries")
    draw(curves, len(paths), options.output)
    save_results(options.output, "fig11_retrieval", results)


def draw(curves: dict[str, np.ndarray], count: int, folder: Path) -> None:
    """Draw the curves, and beside them how far FSH3D is above ESH: by eye the curves are one."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6))
    colors = dict(zip(dict.fromkeys(name.rsplit("-", 1)[0] for name in curves), plt.cm.tab10.colors, strict=False))
    for name, given in curves.items():
        values = np.where(given > 0, given, np.nan)  # 0: no class is large enough for so small a recall
        kind, grid = name.rsplit("-", 1)
        line = "--" if grid == "FSH3D" else "-"
        width, label = 1 if grid == "ESH" else 2.2, f"{kind}, {grid}"
        left.plot(RECALL_LEVELS, values, line, color=colors[kind], lw=width, label=label)
        if grid == "FSH3D":
            rise = 100 * (values - curves[f"{kind}-ESH"])
            right.plot(RECALL_LEVELS, rise, ".-", color=colors[kind], label=kind)
    left.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02), title=f"{count} models")
    right.axhline(0, color="black", lw=0.8)
    right.set(xlabel="recall", ylabel="difference of precision, percentage points", xlim=(0, 1), title="FSH3D − ESH")
    widest = max(1.0, 1.1 * max(abs(value) for value in right.get_ylim()))
    right.set_ylim(-widest, widest)
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    figure.tight_layout()
    save_figure(folder, "fig11_precision_recall", figure)


if __name__ == "__main__":
    run(main)
