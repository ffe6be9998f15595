"""Lay one scan on another from any position, then let Open3D's ICP settle the last bit.

ICP converges only from nearby: started from where two scanners left their data, in other axes and other units, it ends
anywhere. The spherical registration needs no first guess and finds the scale as well; what it returns is a good start
for any local method, and its confidence says when there is nothing to start from. Without files, a cloud of a stone is
turned upside down, made a thousand times larger as if in millimetres, and laid on the mesh of the same stone.

    python pipelines/align_scans.py --output output/align
    python pipelines/align_scans.py scan.ply model.stl --output output/align
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import alignment_picture, encode_png

SAMPLES = Path(__file__).parents[1] / "samples"
ICP = o3d.pipelines.registration


def _demonstration() -> tuple[Any, Any]:
    """A cloud in millimetres, upside down and far away, and the mesh it belongs to."""
    cloud = fsh.read_geometry(SAMPLES / "stone_cloud.xyzn")
    pose = np.eye(4)
    pose[:3, :3] = 1000 * o3d.geometry.get_rotation_matrix_from_xyz((np.pi - 0.3, 0.5, 1.0))
    pose[:3, 3] = 2000, -500, 300
    return cloud.transform(pose), fsh.read_geometry(SAMPLES / "stone_degree8.ply")


def _points(geometry: Any, given: np.ndarray) -> Any:
    """The points that the registration measured on, as a cloud with normals for ICP."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(given))
    if isinstance(geometry, o3d.geometry.PointCloud) and geometry.has_normals():
        cloud.normals = geometry.normals
    else:
        cloud.estimate_normals()
    return cloud


def _line(name: str, fitness: float, rmse: float, size: float) -> str:
    return f"  {name:<33} fitness {fitness:.3f}, RMSE {100 * rmse / size:.3f} % of the target's diagonal"


def main() -> int:
    """Align, refine, draw; the exit code is 0 if the answer can be trusted, 1 if not."""
    parser = argparse.ArgumentParser(description="Align two scans and refine with ICP.")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="source and target; none: the samples")
    parser.add_argument("--rigid", action="store_true", help="both are in the same units")
    parser.add_argument("--output", type=Path, default=Path("output/align"), help="folder for the results")
    options = parser.parse_args()
    if len(options.files) not in (0, 2):
        parser.error("give two files, source and target, or none")
    options.output.mkdir(parents=True, exist_ok=True)
    source, target = map(fsh.read_geometry, options.files) if options.files else _demonstration()

    option = fsh.SphericalRegistrationOption(with_scaling=not options.rigid)
    found = fsh.registration_spherical(source, target, option)
    first, second = _points(source, found.source_points), _points(target, found.target_points)
    reach, size = (
        found.max_correspondence_distance,
        float(np.linalg.norm(second.get_max_bound() - second.get_min_bound())),
    )
    alone = ICP.registration_icp(first, second, reach, np.eye(4), ICP.TransformationEstimationPointToPlane())
    refined = ICP.registration_icp(
        first, second, reach, found.transformation, ICP.TransformationEstimationPointToPlane()
    )
    print(f"confidence {found.confidence:.2f}, ambiguity {found.ambiguity}, scale {found.scale:.6g}")
    print(_line("ICP from where they lie", alone.fitness, alone.inlier_rmse, size))
    print(_line("spherical registration", found.fitness, found.inlier_rmse, size))
    print(_line("spherical registration, then ICP", refined.fitness, refined.inlier_rmse, size))

    aligned = type(source)(source).transform(refined.transformation)
    fsh.write_geometry(options.output / "aligned.ply", aligned)
    picture = options.output / "aligned.png"
    atomic_write_bytes(picture, encode_png(alignment_picture(source, target, aligned)))
    print(f"Open {picture}: where both colours mix, the surfaces coincide.")
    return 0 if found.confidence >= 0.5 else 1


if __name__ == "__main__":
    raise SystemExit(main())
