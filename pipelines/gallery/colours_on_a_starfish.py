"""Keep a body with arms, and the colours on it, in a few thousand numbers.

No point inside a starfish sees all of its skin, so that one radius in each direction cannot describe it. A map of the
skin onto the sphere can: position becomes three functions there, and anything else that is known at the vertices rides
along as more of them. The price is the map: it exists for closed surfaces without handles only, takes seconds, and what
is thin lands on a small piece of the sphere, where it needs high degrees to come back. Hence the tips are the last to
arrive as degrees are added.

    python pipelines/gallery/colours_on_a_starfish.py --output output/gallery
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.geometry import MeshArrays
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[2] / "samples"
BANDWIDTHS = (6, 12, 32)
SIZE, VERTICES = 180, 10_000
ABOVE = (0.5, -1.0, 2.0)  # from where the five arms are seen


def _striped(mesh: o3d.geometry.TriangleMesh) -> np.ndarray:
    """Colours (v, 3) in rings about the middle, which show where the skin goes."""
    points = np.asarray(mesh.vertices)
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    ring = 0.5 + 0.5 * np.cos(5 * np.pi * distance / distance.max())[:, None]
    return ring * (0.93, 0.80, 0.55) + (1 - ring) * (0.75, 0.25, 0.18)


def main() -> int:
    """Map, encode, decode at several bandwidths, and draw."""
    parser = argparse.ArgumentParser(description="Encode a body that is not star-shaped, with its colours.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    mesh = fsh.read_geometry(SAMPLES / "starfish.ply")
    mesh.compute_vertex_normals()
    colors = _striped(mesh)
    mesh.vertex_colors = o3d.utility.Vector3dVector(colors)
    surface = fsh.conformal_map(mesh)
    print(f"mapped: {surface.flipped} triangles flipped")
    sphere = MeshArrays(surface.positions, surface.mesh.triangles)
    spread = colors[surface.source_vertices]
    shape = fsh.ConformalShape.from_map(surface, max(BANDWIDTHS), attributes={"colors": spread})

    pictures = [
        render_thumbnail(mesh, width=SIZE, height=SIZE, direction=ABOVE),
        render_thumbnail(sphere, width=SIZE, height=SIZE, direction=ABOVE, colors=spread, normals=sphere.vertices),
    ]
    captions = ["as given", "its map"]
    for bandwidth in BANDWIDTHS:
        again = shape.truncated(bandwidth).to_triangle_mesh(VERTICES)
        error = fsh.surface_error(mesh, again, samples=20_000).relative().rmse
        print(f"{6 * bandwidth**2:>6} numbers: RMSE {100 * error:.2f} % of the diagonal")
        pictures.append(render_thumbnail(again, width=SIZE, height=SIZE, direction=ABOVE, around=mesh))
        captions.append(f"{6 * bandwidth**2} numbers: RMSE {100 * error:.2g} %")
    atomic_write_bytes(folder / "colours_on_a_starfish.png", encode_png(side_by_side(pictures, captions)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
