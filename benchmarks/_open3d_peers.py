"""Open3D's alignment by features, as in its tutorial: thinned clouds, FPFH, and RANSAC on its matches."""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

methods = o3d.pipelines.registration


def thinned_cloud(points: NDArray[np.float64], voxel: float) -> Any:
    """Return a cloud with a point and a normal in each voxel."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * voxel, 30))
    return cloud


def fpfh(cloud: Any, voxel: float) -> Any:
    """Return the features of a cloud's points."""
    return methods.compute_fpfh_feature(cloud, o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 100))


def ransac_on_features(clouds: Any, features: Any, voxel: float) -> Any:
    """Return RANSAC's result on matches of the features of two clouds."""
    return methods.registration_ransac_based_on_feature_matching(
        *clouds,
        *features,
        True,
        1.5 * voxel,
        methods.TransformationEstimationPointToPoint(False),
        3,
        [
            methods.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            methods.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
        ],
        methods.RANSACConvergenceCriteria(100_000, 0.999),
    )
