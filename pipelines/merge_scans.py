"""From a dozen depth views in unknown places to one closed mesh.

What a depth camera gives is a part, in the camera's own frame, with noise; the model has to be put together before
anything can be done with it. Here the parts are made from a sample, so that the truth is known: rays are cast from a
dozen directions, depths get noise of 0.2 % of the size, and each view is put into a frame of its own. Then they are
registered without a first guess, merged, and the field on shells turns the cloud into one closed surface, whose
distance to the truth is printed. The trade-off is in the last step: more shells and degrees show more detail, and more
of the noise.

    python pipelines/merge_scans.py --output output/merge
    python pipelines/merge_scans.py model.ply --views 20 --output output/merge
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d

import fsh3d_o3d as fsh
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import encode_png, render_thumbnail, scans_picture, side_by_side

SAMPLES = Path(__file__).parents[1] / "samples"
NOISE = 0.002  # of the diagonal along each ray, about that of a good depth camera at one metre
DISTANCE = 2.0  # diagonals from the middle to each camera
FIELD = 30  # degrees that a camera sees; the body fills it at this distance


def _views(mesh: Any, count: int, pixels: int) -> list[tuple[Any, np.ndarray]]:
    """Clouds with normals towards the camera, each in a frame of its own, and where the camera stood in it."""
    rng = np.random.default_rng(0)
    box = mesh.get_axis_aligned_bounding_box()
    middle, size = box.get_center(), float(np.linalg.norm(box.get_extent()))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    views = []
    for direction in fsh.fibonacci_grid(count).directions:
        eye = middle + DISTANCE * size * direction
        up = [0, 0, 1] if abs(direction[2]) < 0.9 else [0, 1, 0]
        rays = scene.create_rays_pinhole(
            fov_deg=FIELD, center=list(middle), eye=list(eye), up=up, width_px=pixels, height_px=pixels
        )
        depth = scene.cast_rays(rays)["t_hit"].numpy().ravel().astype(np.float64)
        along = rays.numpy().reshape(-1, 6)[:, 3:].astype(np.float64)
        seen = np.isfinite(depth)
        along, depth = along[seen], depth[seen]
        depth += NOISE * size * rng.standard_normal(len(depth)) / np.linalg.norm(along, axis=1)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(eye + along * depth[:, None]))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
        cloud.orient_normals_towards_camera_location(eye)
        pose = np.eye(4)
        pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_quaternion(rng.standard_normal(4))
        pose[:3, 3] = 5 * size * rng.standard_normal(3)
        views.append((cloud.transform(pose), pose[:3, :3] @ eye + pose[:3, 3]))
    return views


def main() -> int:
    """Make the views, register, merge, close; the exit code is 0 if all views were placed, 1 if not."""
    parser = argparse.ArgumentParser(description="Register depth views and close them to one mesh.")
    parser.add_argument("model", nargs="?", type=Path, default=SAMPLES / "hand.ply", help="what is looked at")
    parser.add_argument("--views", type=int, default=12, help="number of cameras, spread over the sphere")
    parser.add_argument("--pixels", type=int, default=200, help="side of each depth image")
    parser.add_argument("--bandwidth", type=int, default=24, help="degrees of the closed surface")
    parser.add_argument("--shells", type=int, default=48, help="shells of the closed surface")
    parser.add_argument("--output", type=Path, default=Path("output/merge"), help="folder for the results")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    truth = fsh.read_geometry(options.model)
    size = float(np.linalg.norm(truth.get_axis_aligned_bounding_box().get_extent()))
    views = _views(truth, options.views, options.pixels)

    result = fsh.register_scans([cloud for cloud, _ in views], viewpoints=[eye for _, eye in views], progress=True)
    print(result)
    merged = result.merged(voxel=size / 200)
    shape = fsh.ShellShape.from_geometry(
        merged, bandwidth=options.bandwidth, shells=options.shells, field="signed_distance"
    )
    closed = shape.to_triangle_mesh(96)
    # The merged model lies where the first view does: for the comparison it goes back onto the truth.
    back = fsh.registration_spherical(closed, truth, fsh.SphericalRegistrationOption(with_scaling=False))
    aligned = o3d.geometry.TriangleMesh(closed).transform(back.transformation)
    error = fsh.surface_error(truth, aligned)
    off = 100 * error.rmse / size
    print(f"{len(merged.points)} points, closed: {closed.is_watertight()}, RMSE {off:.2f} % of the diagonal")

    fsh.write_geometry(options.output / "merged.ply", merged)
    fsh.write_geometry(options.output / "closed.ply", closed)
    scans = result.in_one_frame()
    inverse = np.linalg.inv(back.transformation)
    pictures = [
        render_thumbnail(geometry, width=420, height=420, around=merged)
        for geometry in (o3d.geometry.TriangleMesh(truth).transform(inverse), closed)
    ]
    rows = [scans_picture(scans), side_by_side(pictures, ["truth", "closed mesh of all views"])]
    for name, row in zip(("scans.png", "closed.png"), rows, strict=True):
        atomic_write_bytes(options.output / name, encode_png(row))
    print(f"Open {options.output / 'scans.png'} (each view in its colour) and {options.output / 'closed.png'}.")
    return 1 if result.unplaced else 0


if __name__ == "__main__":
    raise SystemExit(main())
