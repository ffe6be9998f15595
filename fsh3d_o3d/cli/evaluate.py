"""``fsh3d evaluate``: how well a descriptor retrieves the classes of a library."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import astuple
from pathlib import Path
from typing import Any

from fsh3d_o3d.adapters.writing import atomic_write_bytes
from fsh3d_o3d.cli.describe import SHD_OPTIONS
from fsh3d_o3d.retrieval.classification import read_classification
from fsh3d_o3d.retrieval.evaluation import Evaluation, evaluate_models
from fsh3d_o3d.retrieval.shd import SHDDescriptor, on_equiangular_grid

_COLUMNS = ("nearest neighbour", "first tier", "second tier", "E-measure", "DCG")


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "evaluate",
        help="measure retrieval on a classified library",
        description="Describe the models of a classification, rank them against each other, and score the rankings "
        "as the Princeton Shape Benchmark does.",
    )
    parser.add_argument("--models", required=True, metavar="DIR", help="where the models are, in any sub-folder")
    parser.add_argument("--classification", required=True, metavar="FILE", help="classes and model ids (.cla)")
    parser.add_argument("--descriptor", choices=("shd",), default="shd", help="what to evaluate (default: shd)")
    parser.add_argument("--option", choices=tuple(SHD_OPTIONS), default="best", help="its options (default: best)")
    parser.add_argument(
        "--grid", choices=("fibonacci", "equiangular"), default="fibonacci", help="directions (default: fibonacci)"
    )
    parser.add_argument(
        "--rerank",
        type=_candidates,
        metavar="K",
        help="align the K best candidates of each query with it and rank them anew (default: none)",
    )
    parser.add_argument("--workers", type=_positive, metavar="N", help="processes (default: all this process may use)")
    parser.add_argument("--json", metavar="FILE", help="write all figures to this file")
    parser.add_argument("--plot", metavar="FILE", help="write the precision-recall curve to this file (.png)")
    parser.add_argument("--no-cache", action="store_true", help="neither use nor fill the cache of descriptors")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Evaluate, print the table, write what was asked for."""
    _check_targets(options)
    option = SHD_OPTIONS[options.option]()
    if options.grid == "equiangular":
        option = on_equiangular_grid(option)
    classification = read_classification(options.classification)
    evaluation = evaluate_models(
        options.models,
        classification,
        SHDDescriptor(option, rerank=options.rerank),
        workers=options.workers,
        cache=not options.no_cache,
        progress=not options.quiet,
    )
    again = "" if options.rerank is None else f", {options.rerank} re-ranked"
    name = f"{options.descriptor} ({options.option}, {options.grid}{again})"
    if options.json:
        text = json.dumps({"descriptor": name, **evaluation.as_dict()}, indent=1, allow_nan=False)
        atomic_write_bytes(options.json, f"{text}\n".encode("ascii"))
    if options.plot:
        from fsh3d_o3d.retrieval.precision_recall_plot import precision_recall_png  # Pillow is not needed otherwise

        title = f"{name}, {evaluation.models} models"
        atomic_write_bytes(options.plot, precision_recall_png(evaluation.metrics.precision_recall, title))
    print("\n".join(_table(name, evaluation)))
    for failed in evaluation.failed:
        print(f"fsh3d: failed: {failed.path}: {failed.reason}", file=sys.stderr)
    return 1 if evaluation.failed else 0


def _check_targets(options: argparse.Namespace) -> None:
    """Refuse before the long part what cannot be written after it."""
    if options.plot and Path(options.plot).suffix.lower() != ".png":
        raise ValueError(f"{options.plot!r}: the curve is written as .png")
    for target in filter(None, (options.json, options.plot)):
        if not Path(target).parent.is_dir():
            raise ValueError(f"{target!r}: there is no folder {str(Path(target).parent)!r}")


def _table(name: str, evaluation: Evaluation) -> list[str]:
    metrics = evaluation.metrics
    rows = {"micro": astuple(metrics.micro), "macro": astuple(metrics.macro)}
    return [
        f"{name}: {evaluation.models} models, {len(metrics.classes)} classes scored, {len(evaluation.failed)} failed",
        "  ".join([f"{'%':<6}", *_COLUMNS]),
        *(
            "  ".join(
                [
                    f"{row:<6}",
                    *(f"{100 * value:>{len(column)}.1f}" for value, column in zip(values, _COLUMNS, strict=True)),
                ]
            )
            for row, values in rows.items()
        ),
        f"{1000 * evaluation.seconds_per_model:.1f} ms of CPU a model, {evaluation.seconds:.1f} s in all, "
        f"{evaluation.cached} from the cache",
    ]


def _positive(text: str, maximum: int = 1024) -> int:
    value = int(text)
    if not 1 <= value <= maximum:
        raise argparse.ArgumentTypeError(f"{text} is not between 1 and {maximum}")
    return value


def _candidates(text: str) -> int:
    return _positive(text, 10**6)
