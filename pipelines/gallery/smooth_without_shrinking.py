"""Smooth a surface without shrinking it.

Averaging each vertex with its neighbours removes roughness and body alike: it works edge by edge, so that what it does
depends on the triangulation, and the shape melts. In the coefficients of a shape, size sits in the lowest degrees and
roughness in the highest, and a filter tells them apart. The heat kernel damps degree l by exp(−t l(l+1)): one number
t, the same effect on any mesh of the same body. The trade-off: a degree is a scale and not a place, so that wanted
edges of the size of the roughness go with it. Cutting degrees off at once smooths too, but leaves ripples beside edges.

    python pipelines/gallery/smooth_without_shrinking.py --output output/gallery
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[2] / "samples"
BANDWIDTH = 32
VERTICES = 10_000  # of what comes back
TIMES = (0.002, 0.01)  # rad²: features narrower than about √t radians fade
ITERATIONS = (15, 75)  # of averaging


def _roughness(mesh: o3d.geometry.TriangleMesh, center: np.ndarray) -> float:
    """The share of the radius, in RMS, that needs degrees of 8 and more."""
    energies = fsh.degree_energies(fsh.RadialShape.from_geometry(mesh, BANDWIDTH, center=center).coefficients)
    return float(np.linalg.norm(energies[8:]) / energies[0])


def main() -> int:
    """Smooth by averaging and by filtering, and compare what is left of the volume."""
    parser = argparse.ArgumentParser(description="Smooth a surface without shrinking it.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    mesh = fsh.read_geometry(SAMPLES / "bennu_like.ply")
    shape = fsh.RadialShape.from_geometry(mesh, BANDWIDTH)
    versions = {"as given": mesh}
    for count in ITERATIONS:
        versions[f"{count} averages"] = mesh.filter_smooth_simple(count)
    for time in TIMES:
        versions[f"t = {time:g}"] = shape.filtered(fsh.heat_filter(BANDWIDTH, time)).to_triangle_mesh(VERTICES)

    pictures, captions = [], []
    for name, version in versions.items():
        change = version.get_volume() / mesh.get_volume() - 1
        print(f"{name:<14} roughness {100 * _roughness(version, shape.center):5.2f} %   volume {100 * change:+6.2f} %")
        version.compute_vertex_normals()
        pictures.append(render_thumbnail(version, width=190, height=190, around=mesh))
        captions.append(name if version is mesh else f"{name}: volume {100 * change:+.1f} %")
    atomic_write_bytes(folder / "smooth_without_shrinking.png", encode_png(side_by_side(pictures, captions)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
