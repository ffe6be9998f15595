"""Map a closed surface onto the sphere, conformally and balanced, and see what 3b² numbers hold of it either way.

A conformal map keeps angles, and starves whatever sticks out: fingers shrink to specks that no bandwidth resolves. The
balanced map gives every part its share of the sphere at the price of sheared triangles. The pictures show the surface
and the sphere with the same colours; the table, what either map makes of the reconstruction.

    python pipelines/sphere_map.py [MESH] --output output/sphere_map
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.geometry import MeshArrays, triangle_normals
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[1] / "samples"


def main() -> int:
    """Map, encode, decode, compare."""
    parser = argparse.ArgumentParser(description="Map a closed surface of genus 0 onto the sphere, two ways.")
    parser.add_argument("mesh", nargs="?", type=Path, default=SAMPLES / "hand.ply", help="closed mesh of genus 0")
    parser.add_argument("--bandwidth", type=int, default=32, help="b: 3b² numbers hold the shape")
    parser.add_argument("--output", type=Path, default=Path("output/sphere_map"), help="folder for the pictures")
    options = parser.parse_args()
    mesh = fsh.read_geometry(options.mesh)
    options.output.mkdir(parents=True, exist_ok=True)
    print(f"{'map':<10} {'shear mean':>10} {'shear 99 %':>10} {'area, log rms':>13} {'RMSE %':>8}")
    for name, option in (
        ("conformal", fsh.ConformalMapOption(area_weight=0)),
        ("balanced", fsh.ConformalMapOption()),
    ):
        surface = fsh.conformal_map(mesh, option)
        shape = fsh.ConformalShape.from_map(surface, options.bandwidth)
        again, normals = shape.mesh_arrays()
        error = fsh.surface_error(mesh, again).relative()
        print(
            f"{name:<10} {surface.distortion_mean:>10.2f} {surface.distortion_99:>10.2f} "
            f"{surface.area_distortion:>13.2f} {100 * error.rmse:>8.3f}"
        )
        # The colour of a place tells its normal on the surface; triangles have corners of their own to stay crisp.
        corners = surface.mesh.triangles.ravel()
        facing = triangle_normals(surface.mesh.vertices[surface.mesh.triangles])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        tint = np.repeat(0.5 + 0.5 * facing, 3, axis=0)
        loose = np.arange(len(corners)).reshape(-1, 3)
        ball = MeshArrays(surface.positions[corners], loose)
        pictures = [
            render_thumbnail(MeshArrays(surface.mesh.vertices[corners], loose), colors=tint),
            render_thumbnail(ball, colors=tint, direction=(0.3, -1, 0.4)),
            render_thumbnail(ball, colors=tint, direction=(-0.3, 1, -0.4)),
            render_thumbnail(again, normals=normals),
        ]
        labels = (
            "surface, coloured by its normals",
            f"{name} map",
            "from behind",
            f"{shape.coefficients.size} numbers",
        )
        picture = encode_png(side_by_side(pictures, labels))
        atomic_write_bytes(options.output / f"{name}.png", picture)
    print(f"wrote conformal.png and balanced.png to {options.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
