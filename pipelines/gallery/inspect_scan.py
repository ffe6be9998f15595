"""Lay a scan on its model, whatever its axes and its units, and see where they differ and what was missed.

A scanner knows neither the model's axes nor, often, its units, and ICP needs a start nearby. Correlating spherical
harmonics looks at all rotations at once, and scale follows from the spread of the area, so that no start is needed. The
trade-off: both are compared as wholes. A scan with holes and outliers, like this one, is within reach; one that shows
half of the body is not, and the confidence says so. Deviations are measured afterwards, and are only as good as the
alignment: closest points settle it, so that a dent draws its surroundings a little towards itself.

    python pipelines/gallery/inspect_scan.py --output output/gallery
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
LARGEST, FARTHEST = 0.02, 0.1  # of the model's diagonal: the dark ends of the colours


def main() -> int:
    """Align, measure, draw; the exit code is 1 if the alignment is not to be trusted."""
    parser = argparse.ArgumentParser(description="Colour a scan by its deviation from the model.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    model = fsh.read_geometry(SAMPLES / "bennu_like.ply")
    model.compute_vertex_normals()
    scan = fsh.read_geometry(SAMPLES / "bennu_cloud.ply")
    pose = np.eye(4)  # as from a scanner that stands elsewhere and counts in millimetres
    pose[:3, :3] = 1000 * o3d.geometry.get_rotation_matrix_from_xyz((2.0, -0.7, 1.1))
    pose[:3, 3] = 800, -300, 1500
    scan.transform(pose)

    found = fsh.registration_spherical(scan, model)
    aligned = o3d.geometry.PointCloud(scan).transform(found.transformation)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(model))
    deviation = scene.compute_distance(np.asarray(aligned.points, dtype=np.float32)).numpy()
    diagonal = float(np.linalg.norm(model.get_max_bound() - model.get_min_bound()))
    off = float(np.abs(found.transformation @ pose - np.eye(4)).max())
    print(f"confidence {found.confidence:.2f}, scale {found.scale:.6f}, off the true transformation by {off:.1e}")
    print(f"deviation: median {100 * np.median(deviation) / diagonal:.2f} % of the diagonal")
    print(
        f"           more than {100 * LARGEST:g} %: {100 * np.mean(deviation > LARGEST * diagonal):.1f} % of the points"
    )

    gap = cKDTree(np.asarray(aligned.points)).query(np.asarray(model.vertices))[0]
    near = np.flatnonzero(deviation < 3 * LARGEST * diagonal)  # outliers would hide the body
    body = aligned.select_by_index(near)
    colors = error_colors(deviation[near], LARGEST * diagonal)
    pictures = [
        render_thumbnail(scan, width=SIZE, height=SIZE),
        render_thumbnail(model, width=SIZE, height=SIZE),
        render_thumbnail(body, width=SIZE, height=SIZE, around=model, colors=colors),
        render_thumbnail(model, width=SIZE, height=SIZE, colors=error_colors(gap, FARTHEST * diagonal)),
    ]
    captions = ["scan, as it came", "model", f"dark: {100 * LARGEST:g} % off", "dark: not scanned"]
    atomic_write_bytes(folder / "inspect_scan.png", encode_png(side_by_side(pictures, captions)))
    return 0 if found.confidence >= 0.5 else 1


if __name__ == "__main__":
    raise SystemExit(main())
