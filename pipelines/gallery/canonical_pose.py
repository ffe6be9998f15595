"""Turn shapes upright: the same pose for every copy, however it came.

Files from many sources lie on their sides, stand on their heads, or follow another convention for which way is up.
Principal axes fix that only up to signs, and not at all where two of them are alike. A canonical pose is the rotation
in which the coefficients agree best with a fixed template: it needs no axes, and turned copies of a shape end up in
the same pose. The trade-off: poses of different shapes have nothing to do with each other (to compare two, align them),
and a symmetric shape has several that are equally good. The report of its symmetries says so, and which.

    python pipelines/gallery/canonical_pose.py --output output/gallery
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[2] / "samples"
NAMES = ("bennu_like.ply", "gem.stl", "cushion_quads.obj")
COPIES, SIZE, VERTICES = 3, 116, 6000


def _symmetry(report: fsh.SymmetryReport) -> str:
    """What a report says, in a few words."""
    axes = ", ".join(f"{axis.order}-fold" if axis.order else "of revolution" for axis in report.axes[:3])
    return f"axes {axes or 'none'}; planes {len(report.planes)}"


def main() -> int:
    """Pose turned copies of three shapes; the exit code is 1 if copies do not come out alike."""
    parser = argparse.ArgumentParser(description="Turn shapes upright.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    turns = Rotation.random(COPIES, rng=np.random.default_rng(3)).as_matrix()
    strips, worst = [], 0.0
    for name in NAMES:
        shape = fsh.RadialShape.from_geometry(fsh.read_geometry(SAMPLES / name), 24)
        given = [shape.rotated(turn) for turn in turns]
        posed = [copy.rotated(fsh.canonical_rotation(copy)) for copy in given]
        first = posed[0].coefficients
        apart = max(float(np.linalg.norm(copy.coefficients - first) / np.linalg.norm(first[1:])) for copy in posed)
        pose = fsh.canonical_rotation(given[0])
        print(f"{name:<18} copies differ by {apart:.1e}; margin {pose.margin:.2f}; {_symmetry(pose.symmetries)}")
        worst = max(worst, apart)
        pictures = [
            render_thumbnail(copy.to_triangle_mesh(VERTICES), width=SIZE, height=SIZE) for copy in (*given, *posed)
        ]
        captions = [f"as given {i + 1}" for i in range(COPIES)] + [f"posed {i + 1}" for i in range(COPIES)]
        strips.append(side_by_side(pictures, captions))
    atomic_write_bytes(folder / "canonical_pose.png", encode_png(np.concatenate(strips)))
    return 0 if worst < 0.05 else 1


if __name__ == "__main__":
    raise SystemExit(main())
