"""Retrieval on a classified library: find the models, describe them, rank them, score the rankings."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d._value import value
from fsh3d_o3d.evaluation.classification import Classification
from fsh3d_o3d.evaluation.metrics import RECALL_LEVELS, RetrievalMetrics, retrieval_metrics
from fsh3d_o3d.evaluation.model_files import ModelFiles, find_models
from fsh3d_o3d.evaluation.neighborhood import neighborhood_distances
from fsh3d_o3d.jobs import Descriptor, FailedInput, extract_descriptors

__all__ = ["Evaluation", "evaluate_models"]


@value
class Evaluation:
    """How well a descriptor retrieves, and what that took."""

    metrics: RetrievalMetrics
    """Scores over the models that could be described; classes by their full names."""
    models: int
    """How many those are."""
    failed: tuple[FailedInput, ...]
    """Models that were not found, not unique, or could not be described: they are neither queries nor candidates."""
    cached: int
    """Descriptors that came from the cache."""
    seconds_per_model: float
    """Mean CPU seconds to read and describe a model on one thread, in this run or when it was put into the cache."""
    seconds: float
    """Wall-clock seconds of the whole evaluation."""
    neighborhood: RetrievalMetrics | None = None
    """Scores of the rankings by ``neighborhood_distances``, which use the library itself; None: not asked for."""

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON; scores as fractions, NaN never."""
        return {
            **_averages(self.metrics),
            "models": self.models,
            "failed": [dataclasses.asdict(failed) for failed in self.failed],
            "seconds_per_model": self.seconds_per_model,
            "seconds": self.seconds,
            "cached": self.cached,
            "recall": RECALL_LEVELS.tolist(),
            "precision_recall": self.metrics.precision_recall.tolist(),
            "classes": [dataclasses.asdict(scores) for scores in self.metrics.classes],
            "neighborhood": None if self.neighborhood is None else _averages(self.neighborhood),
        }


def evaluate_models(
    folder: str | os.PathLike[str],
    classification: Classification,
    descriptor: Descriptor,
    *,
    workers: int | None = None,
    cache: bool = True,
    progress: bool = False,
    neighbors: int | None = None,
) -> Evaluation:
    """Score a descriptor on a classified library.

    Every model is a query for the others of its class; the benchmark's class of miscellaneous models is never.

    Args:
        folder: Where the models are: ``m123.off``, ``123.ply``, …, in any sub-folder (see ``find_models``).
        classification: Ids and classes.
        descriptor: What to evaluate.
        workers: Processes; by default one for each core that this process may use.
        cache: Use and fill the cache of descriptors.
        progress: Show a bar, on a terminal or in a notebook.
        neighbors: Also score rankings by ``neighborhood_distances`` with this many neighbours.

    Raises:
        OSError: The folder cannot be listed.
        ValueError: Too few models could be described for any class to be scored.

    Example:
        >>> from pathlib import Path
        >>> from fsh3d_o3d.descriptors import SHDDescriptor
        >>> content = "PSB 1  2 5  gems 0 2  gem gem_rotated  stones 0 3  bennu_like bennu_like_low stone_degree8"
        >>> written = Path("toy.cla").write_text(content)
        >>> classification = fsh.read_classification("toy.cla")
        >>> descriptor = SHDDescriptor(fsh.SHDOption(bandwidth=8))
        >>> evaluation = fsh.evaluate_models("samples", classification, descriptor, workers=1)
        >>> evaluation.models, evaluation.failed
        (5, ())
        >>> evaluation.metrics.nearest_neighbor
        1.0
        >>> evaluation.as_dict()["models"]
        5
    """
    start = time.monotonic()
    if neighbors is not None:
        check.integer(neighbors, "neighbors", minimum=2)
    models = classification.models
    files = find_models(folder, models)
    present = [index for index, model in enumerate(models) if model in files.paths]
    extraction = extract_descriptors(
        [files.paths[models[index]] for index in present],
        descriptor,
        workers=workers,
        cache=cache,
        progress=progress,
    )
    failed = (*_not_found(folder, files), *extraction.failed)
    labels = [classification.classes[label].full_name for label in classification.labels]
    described = [labels[present[index]] for index in extraction.indices]
    if not described:
        first = f"; {failed[0].path}: {failed[0].reason}" if failed else ""
        raise ValueError(f"none of the {len(models)} models of the classification could be described{first}")
    unscored = {group.full_name for group in classification.classes if group.miscellaneous}
    try:
        distances = descriptor.distances(extraction.descriptors, extraction.descriptors, progress=progress)
        metrics = retrieval_metrics(distances, described, unscored=unscored)
        neighborhood = None
        if neighbors is not None:
            closer = neighborhood_distances(distances, neighbors=neighbors)
            neighborhood = retrieval_metrics(closer, described, unscored=unscored)
    except ValueError as error:
        raise ValueError(f"{len(described)} of {len(models)} models could be described: {error}") from error
    return Evaluation(
        metrics=metrics,
        models=len(described),
        failed=failed,
        cached=extraction.cached,
        seconds_per_model=math.fsum(extraction.seconds) / len(described),
        seconds=time.monotonic() - start,
        neighborhood=neighborhood,
    )


def _averages(metrics: RetrievalMetrics) -> dict[str, Any]:
    return {"micro": dataclasses.asdict(metrics.micro), "macro": dataclasses.asdict(metrics.macro)}


def _not_found(folder: str | os.PathLike[str], files: ModelFiles) -> tuple[FailedInput, ...]:
    missing = [FailedInput(model, f"no file of this name below {os.fsdecode(folder)}") for model in files.missing]
    ambiguous = [
        FailedInput(model, f"{len(paths)} files have this name: {', '.join(map(str, paths[:4]))}")
        for model, paths in files.ambiguous.items()
    ]
    return (*missing, *ambiguous)
