"""Searching in many shapes: retrieval metrics, classifications, descriptors of many files, evaluation."""

from fsh3d_o3d.retrieval.classification import Classification, ShapeClass, read_classification
from fsh3d_o3d.retrieval.descriptor_cache import clear_descriptor_cache, descriptor_cache_path
from fsh3d_o3d.retrieval.evaluation import Evaluation, evaluate_models
from fsh3d_o3d.retrieval.extraction import Descriptor, Extraction, FailedInput, extract_descriptors
from fsh3d_o3d.retrieval.metrics import (
    RECALL_LEVELS,
    ClassScores,
    RetrievalMetrics,
    RetrievalScores,
    retrieval_metrics,
)
from fsh3d_o3d.retrieval.shape_index import (
    Hit,
    IndexedModel,
    IndexSummary,
    IndexUpdate,
    NearDuplicate,
    ShapeIndex,
    ShapeIndexError,
)

__all__ = [
    # metrics
    "RECALL_LEVELS",
    "ClassScores",
    "RetrievalMetrics",
    "RetrievalScores",
    "retrieval_metrics",
    # many files
    "Classification",
    "Descriptor",
    "Evaluation",
    "Extraction",
    "FailedInput",
    "ShapeClass",
    "clear_descriptor_cache",
    "descriptor_cache_path",
    "evaluate_models",
    "extract_descriptors",
    "read_classification",
    # index
    "Hit",
    "IndexSummary",
    "IndexUpdate",
    "IndexedModel",
    "NearDuplicate",
    "ShapeIndex",
    "ShapeIndexError",
]
