"""``fsh3d evaluate``: how well a descriptor retrieves the classes of a library."""

from __future__ import annotations

import argparse
import json
from dataclasses import astuple, replace
from typing import Any

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d.cli.console import say
from fsh3d_o3d.cli.describe import SHD_OPTIONS
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.descriptors import CPSHDDescriptor, CPSHDOption, SHDDescriptor, on_equiangular_grid
from fsh3d_o3d.evaluation import Evaluation, evaluate_models, read_classification
from fsh3d_o3d.jobs import Descriptor

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
    parser.add_argument("--descriptor", choices=("shd", "cpshd"), default="shd", help="what to evaluate (default: shd)")
    parser.add_argument("--option", choices=tuple(SHD_OPTIONS), help="options of shd (default: best)")
    parser.add_argument(
        "--grid", choices=("fibonacci", "equiangular"), default="fibonacci", help="directions (default: fibonacci)"
    )
    parser.add_argument(
        "--repair",
        type=_positive,
        metavar="CELLS",
        help="for cpshd, make closed surfaces of genus 0 of all others at this resolution (default: they fail)",
    )
    parser.add_argument(
        "--area-weight", type=float, metavar="A", help="for cpshd, the balance of the map; 0 is conformal"
    )
    parser.add_argument(
        "--rerank",
        type=_candidates,
        metavar="K",
        help="align the K best candidates of each query with it and rank them anew (default: none)",
    )
    parser.add_argument(
        "--neighbors",
        type=_neighbors,
        metavar="K",
        help="score as well rankings that use the library itself, by common neighbours among about K",
    )
    parser.add_argument("--workers", type=_positive, metavar="N", help="processes (default: all this process may use)")
    parser.add_argument("--json", metavar="FILE", help="write all figures to this file")
    parser.add_argument("--plot", metavar="FILE", help="write the precision-recall curve to this file (.png)")
    parser.add_argument("--no-cache", action="store_true", help="neither use nor fill the cache of descriptors")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Evaluate, print the table, write what was asked for."""
    checked_targets(
        {"--json": (options.json, ()), "--plot": (options.plot, (".png",))},
        {"the classification": options.classification},
    )
    descriptor, name = _descriptor(options)
    classification = read_classification(options.classification)
    evaluation = evaluate_models(
        options.models,
        classification,
        descriptor,
        workers=options.workers,
        cache=not options.no_cache,
        progress=not options.quiet,
        neighbors=options.neighbors,
    )
    if options.json:
        text = json.dumps({"descriptor": name, **evaluation.as_dict()}, indent=1, allow_nan=False)
        atomic_write_bytes(options.json, f"{text}\n".encode("ascii"))
    if options.plot:
        from fsh3d_o3d.evaluation import precision_recall_png  # Pillow is not needed otherwise

        title = f"{name}, {evaluation.models} models"
        atomic_write_bytes(options.plot, precision_recall_png(evaluation.metrics.precision_recall, title))
    say(*_table(name, evaluation))
    for failed in evaluation.failed:
        say(f"fsh3d: failed: {failed.path}: {failed.reason}", error=True)
    return 1 if evaluation.failed else 0


def _descriptor(options: argparse.Namespace) -> tuple[Descriptor, str]:
    """What to evaluate, and what to call it."""
    unrelated = {"shd": ("repair", "area_weight"), "cpshd": ("option", "rerank")}[options.descriptor]
    for name in unrelated:
        if getattr(options, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} does not belong to --descriptor {options.descriptor}")
    equiangular = options.grid == "equiangular"
    if options.descriptor == "cpshd":
        option = CPSHDOption(repair=options.repair)
        if options.area_weight is not None:
            option = replace(option, map=replace(option.map, area_weight=options.area_weight))
        described = "refused" if options.repair is None else f"repaired at {options.repair}"
        name = f"cpshd ({options.grid}, area weight {option.map.area_weight:g}, open models {described})"
        return CPSHDDescriptor(on_equiangular_grid(option) if equiangular else option), name
    chosen = options.option or "best"
    shd = SHD_OPTIONS[chosen]()
    again = "" if options.rerank is None else f", {options.rerank} re-ranked"
    name = f"shd ({chosen}, {options.grid}{again})"
    return SHDDescriptor(on_equiangular_grid(shd) if equiangular else shd, rerank=options.rerank), name


def _table(name: str, evaluation: Evaluation) -> list[str]:
    metrics = evaluation.metrics
    rows = {"micro": astuple(metrics.micro), "macro": astuple(metrics.macro)}
    if evaluation.neighborhood is not None:
        rows["micro, common neighbours"] = astuple(evaluation.neighborhood.micro)
        rows["macro, common neighbours"] = astuple(evaluation.neighborhood.macro)
    width = max(6, *map(len, rows))
    return [
        f"{name}: {evaluation.models} models, {len(metrics.classes)} classes scored, {len(evaluation.failed)} failed",
        "  ".join([f"{'%':<{width}}", *_COLUMNS]),
        *(
            "  ".join(
                [
                    f"{row:<{width}}",
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


def _neighbors(text: str) -> int:
    return max(2, _positive(text, 10**6))


def _candidates(text: str) -> int:
    return _positive(text, 10**6)
