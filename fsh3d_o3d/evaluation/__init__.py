"""How well a descriptor retrieves: classifications, metrics of the Princeton benchmark, re-ranking by neighbours."""

from __future__ import annotations

from fsh3d_o3d.evaluation.classification import Classification, ShapeClass, read_classification
from fsh3d_o3d.evaluation.evaluation import Evaluation, evaluate_models
from fsh3d_o3d.evaluation.metrics import (
    RECALL_LEVELS,
    ClassScores,
    RetrievalMetrics,
    RetrievalScores,
    retrieval_metrics,
)
from fsh3d_o3d.evaluation.model_files import find_models
from fsh3d_o3d.evaluation.precision_recall_plot import precision_recall_png

__all__ = [
    "RetrievalScores",
    "ClassScores",
    "ShapeClass",
    "Classification",
    "RECALL_LEVELS",
    "Evaluation",
    "RetrievalMetrics",
    "evaluate_models",
    "find_models",
    "precision_recall_png",
    "read_classification",
    "retrieval_metrics",
]
