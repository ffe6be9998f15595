"""The same work for many files: worker processes that may die, Ray, and a cache of descriptors."""

from __future__ import annotations

from fsh3d_o3d.jobs.descriptor_cache import (
    CachedDescriptor,
    DescriptorCache,
    clear_descriptor_cache,
    descriptor_cache_path,
    key_of,
)
from fsh3d_o3d.jobs.extraction import Descriptor, Extraction, FailedInput, extract_descriptors
from fsh3d_o3d.jobs.ray_tasks import run_tasks_on_ray
from fsh3d_o3d.jobs.worker_pool import Outcome, run_tasks

__all__ = [
    "CachedDescriptor",
    "Descriptor",
    "DescriptorCache",
    "Extraction",
    "FailedInput",
    "Outcome",
    "clear_descriptor_cache",
    "descriptor_cache_path",
    "extract_descriptors",
    "key_of",
    "run_tasks",
    "run_tasks_on_ray",
]
