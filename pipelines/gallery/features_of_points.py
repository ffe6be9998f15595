"""Match points of half a body with the whole, by Open3D's FPFH and by local harmonics in its place.

A feature of points looks at a ball around each. What FPFH keeps of it is histograms of angles between normals, which
have to point to one side to be told apart; what local harmonics keep is how the area lies around the normal, whichever
way it points. More of the matches are right, and RANSAC takes one for the other. The price: half as much time again a
point. And neither knows what it would see beyond the cut, so that points near it find no partner.

    python pipelines/gallery/features_of_points.py --output output/gallery
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import encode_png, error_colors, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[2] / "samples"
SIZE = 160
VOXEL, RIGHT = 0.02, 0.05  # of the model's diagonal: between points, and what a right match may be off
methods = o3d.pipelines.registration


def main() -> int:
    """Match, align, draw; the exit code is 1 if the alignment is wrong."""
    parser = argparse.ArgumentParser(description="Local harmonics where FPFH stands.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    model = fsh.read_geometry(SAMPLES / "bennu_like.ply")
    model.compute_vertex_normals()
    diagonal = float(np.linalg.norm(model.get_max_bound() - model.get_min_bound()))
    pose = np.eye(4)
    pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_xyz((2.0, -0.7, 1.1))
    o3d.utility.random.seed(1)
    whole, again = (model.sample_points_uniformly(20_000) for _ in range(2))
    height = np.asarray(again.points) @ [0.6, -0.5, 0.62]
    half = again.select_by_index(np.flatnonzero(height > np.median(height))).transform(pose)
    source, target = (thinned(scan, diagonal) for scan in (half, whole))

    option = fsh.LocalSHDOption.common(half, whole)
    ours = [
        fsh.compute_local_shd_feature(scan, option, np.asarray(few.points))
        for scan, few in ((half, source), (whole, target))
    ]
    near = o3d.geometry.KDTreeSearchParamHybrid(5 * VOXEL * diagonal, 100)
    fpfh = [methods.compute_fpfh_feature(few, near) for few in (source, target)]
    pictures = [render_thumbnail(half, width=SIZE, height=SIZE), render_thumbnail(whole, width=SIZE, height=SIZE)]
    for name, (first, second) in {"FPFH": fpfh, "local harmonics": ours}.items():
        there, back = cKDTree(second.data.T).query(first.data.T)[1], cKDTree(first.data.T).query(second.data.T)[1]
        mutual = np.flatnonzero(back[there] == np.arange(len(there)))
        true = np.asarray(source.points)[mutual] @ pose[:3, :3]
        off = np.linalg.norm(np.asarray(target.points)[there[mutual]] - true, axis=1)
        print(f"{name}: {100 * np.mean(off < RIGHT * diagonal):.0f} % of {len(off)} mutual matches are right")
        matched = source.select_by_index(mutual)
        colors = error_colors(off, 2 * RIGHT * diagonal)
        pictures.append(render_thumbnail(matched, width=SIZE, height=SIZE, around=half, colors=colors))

    limit = 1.5 * VOXEL * diagonal
    found = methods.registration_ransac_based_on_feature_matching(
        source,
        target,
        *ours,
        True,
        limit,
        methods.TransformationEstimationPointToPoint(False),
        3,
        [methods.CorrespondenceCheckerBasedOnDistance(limit)],
        methods.RANSACConvergenceCriteria(100_000, 0.999),
    )
    found = methods.registration_icp(
        source, target, limit, found.transformation, methods.TransformationEstimationPointToPlane()
    )
    off = float(np.abs(found.transformation @ pose - np.eye(4))[:3, :3].max())
    print(f"RANSAC with local harmonics and ICP: rotation off by {off:.3f}")
    captions = ["half a body, turned", "the whole", "FPFH; dark: wrong", "harmonics; dark: wrong"]
    atomic_write_bytes(folder / "features_of_points.png", encode_png(side_by_side(pictures, captions)))
    return 0 if off < 0.05 else 1


def thinned(cloud: o3d.geometry.PointCloud, diagonal: float) -> o3d.geometry.PointCloud:
    """Return points two hundredths of the diagonal apart, with normals."""
    few = cloud.voxel_down_sample(VOXEL * diagonal)
    few.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * VOXEL * diagonal, 30))
    return few


if __name__ == "__main__":
    raise SystemExit(main())
