"""Fit a star shape to the pixels of depth images by gradient descent, beside the least-squares fit.

Three cameras see a stone; a pixel in twenty is wrong, and a cap that no camera sees stays open. Least squares finds the
coefficients in one step, but takes every pixel at its word and the centre as given. Gradient descent through
``ft.evaluate`` may have any loss, here one that gives up on what does not fit, and moves the centre as well, for which
it needs derivatives in the directions of the pixels. The trade-off: hundreds of steps in place of one.

    python pipelines/learning/fit_depth.py --output output/learning
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import open3d as o3d
import torch

import fsh3d_o3d as fsh
from fsh3d_o3d import torch as ft
from fsh3d_o3d.files import atomic_write_bytes
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLE = Path(__file__).parents[2] / "samples" / "stone_degree8.ply"
BANDWIDTH = 12
PIXELS = 40  # along each side of an image
EYES = ((3.0, 0.5, 0.5), (-1.0, 3.0, 0.8), (-1.5, -2.5, 1.0))  # none from below
NOISE, OUTLIERS = 0.005, 0.05  # of depth, standard deviation and share of the pixels
SMOOTHNESS = 3e-7  # weight of the bending energy, which decides where no camera looks
SQUARES_SMOOTHNESS = 1e-5  # the same of least squares, which needs more of it against outliers; the best of several
SCALE = 0.02  # residuals beyond about this, the noise of a depth of 3, are taken for outliers


def depth_points(mesh: o3d.geometry.TriangleMesh) -> np.ndarray:
    """Points (n, 3) where the cameras' rays meet the surface, as far as the depths say."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    rng, points = np.random.default_rng(0), []
    for eye in EYES:
        rays = scene.create_rays_pinhole(50.0, [0, 0, 0], list(eye), [0, 0, 1], PIXELS, PIXELS)
        depth = scene.cast_rays(rays)["t_hit"].numpy().astype(np.float64)
        rays = rays.numpy().astype(np.float64)[np.isfinite(depth)]
        depth = depth[np.isfinite(depth)]
        depth = depth * (1 + NOISE * rng.standard_normal(len(depth)))
        wrong = rng.random(len(depth)) < OUTLIERS
        depth[wrong] *= rng.uniform(0.7, 1.3, wrong.sum())
        points.append(rays[:, :3] + depth[:, None] * rays[:, 3:])
    return np.concatenate(points)


def descend(points: np.ndarray, steps: int) -> fsh.RadialShape:
    """Coefficients and centre by gradient descent from a sphere about the mean of the points."""
    given = torch.from_numpy(points)
    center = given.mean(0).requires_grad_()
    degree = torch.from_numpy(fsh.degrees_and_orders(BANDWIDTH)[0])
    bending = (degree * (degree + 1.0)).square()
    # High degrees take small steps: what is learned is the coefficient times the root of its bending energy.
    scale = 1 / (1 + degree)
    with torch.no_grad():
        radius = (given - center).norm(dim=-1).mean()
    learned = (torch.eye(1, BANDWIDTH**2, dtype=torch.float64)[0] * radius * (4 * torch.pi) ** 0.5).requires_grad_()
    optimiser = torch.optim.Adam([learned, center], lr=0.02)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        coefficients, offset = learned * scale, given - center
        residual = (offset.norm(dim=-1) - ft.evaluate(coefficients, offset)) / SCALE
        loss = torch.log1p(residual.square()).mean() + SMOOTHNESS / SCALE**2 * (bending * coefficients.square()).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return fsh.RadialShape((learned * scale).detach().numpy(), center.detach().numpy())


def least_squares(points: np.ndarray) -> fsh.RadialShape:
    """Coefficients of the best fit about the mean of the points, all pixels alike."""
    center = points.mean(0)
    offset = points - center
    radius = np.linalg.norm(offset, axis=1)
    fit = fsh.fit_coefficients(radius, offset / radius[:, None], BANDWIDTH, smoothness=SQUARES_SMOOTHNESS)
    return fsh.RadialShape(fit.coefficients, center)


def main() -> int:
    """Fit in three ways, compare with the stone, draw."""
    parser = argparse.ArgumentParser(description="Fit a star shape to depth pixels by gradient descent.")
    parser.add_argument("--output", type=Path, default=Path("output/learning"), help="folder for the picture")
    parser.add_argument("--steps", type=int, default=300, help="of gradient descent")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(0)

    mesh = fsh.read_geometry(SAMPLE)
    points = depth_points(mesh)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    fits = {
        "least squares": lambda: least_squares(points),
        "gradient descent": lambda: descend(points, options.steps),
        "robust fit": lambda: fsh.RadialShape.from_geometry(cloud, BANDWIDTH),
    }
    pictures, captions = [render_thumbnail(cloud, width=190, height=190, around=mesh)], [f"{len(points)} pixels"]
    for name, fit in fits.items():
        start = time.process_time()
        shape = fit()
        spent = time.process_time() - start
        again = shape.to_triangle_mesh(10_000)
        error = fsh.surface_error(mesh, again).relative()
        print(
            f"{name:<18} RMSE {100 * error.rmse:5.2f} %   largest {100 * error.maximum:5.2f} %   {spent:.2f} s of CPU"
        )
        pictures.append(render_thumbnail(again, width=190, height=190, around=mesh))
        captions.append(f"{name}: {100 * error.rmse:.2f} %")
    mesh.compute_vertex_normals()
    pictures.append(render_thumbnail(mesh, width=190, height=190))
    captions.append("the stone")
    atomic_write_bytes(options.output / "fit_depth.png", encode_png(side_by_side(pictures, captions)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
