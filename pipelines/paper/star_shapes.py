"""Table 1 and 2, Fig. 9 of the paper: star-shaped bodies, equiangular grid (ESH) against Fibonacci (FSH3D).

G1 is a set of star-shaped meshes, scaled to a bounding-box diagonal of 1; G2 the same, turned at random. Each is
sampled along the directions of a grid, transformed, and decoded; RMSE, MAE and volume error (VE) are measured against
the mesh. Table 1 is the mean of |error(G1) - error(G2)|: how far the errors depend on the pose.

These differences are down to a hundredth of the errors, less than what measuring at other points of the surface would
change. So a turned mesh's coefficients are turned back, exactly, and decoded on the same triangles as the upright
one's, and distances are taken at the same places: at fixed points of the mesh, and at all vertices of the
reconstruction, each weighing its share of the area. Volumes are exact: integrals over the coefficients.

The paper samples clouds, without saying how a value on the grid is made from points; here exact rays are the rule, and
``--clouds`` takes the inverse-distance mean of the eight nearest of 100,000 points. Its 110 shapes are not identified
anywhere: any folder of meshes will do, of which those are taken that at least 98 % of rays from a centre meet once.

    python pipelines/paper/star_shapes.py --shapes FOLDER [--full] [--clouds]
"""

from __future__ import annotations

import functools
import os
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from _common import parser, plt, run, save_figure, save_results, table
from matplotlib.collections import PolyCollection
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import (
    MeshArrays,
    PointArrays,
    area_samples,
    enclosed_volume,
    sphere_mesh,
    triangle_areas,
    triangle_normals,
    weld,
)
from fsh3d_o3d.radial import sample_radial, star_center
from fsh3d_o3d.shapes import RadialShape

SAMPLES = Path(__file__).parents[2] / "samples"
METRICS = ("RMSE", "MAE", "VE")
METHODS = ("ESH 4b²", "SFG 4b²", "SFG 4b², fit", "SFG 6b²")
ORIGIN = np.zeros(3)
CLOUD = 100_000


@dataclass(frozen=True)
class Task:
    """One mesh and all that is done with it."""

    path: Path
    bandwidths: tuple[int, ...]
    rotations: int
    """How many poses beside the upright one, at the first bandwidth."""
    seed: int
    clouds: bool
    points: int
    """On the mesh, from which distances are taken; as many as vertices of the reconstruction, at least."""


@functools.lru_cache(maxsize=16)
def transform(method: str, b: int) -> fsh.SphericalHarmonicTransform:
    """Return a grid with its weights, or the least-squares fit on it."""
    if method == "ESH 4b²":
        return fsh.SphericalHarmonicTransform(b, grid=fsh.equiangular_grid(b), weights=fsh.driscoll_healy_weights(b))
    grid = fsh.fibonacci_grid((6 if method == "SFG 6b²" else 4) * b * b)
    if method == "SFG 4b², fit":
        return fsh.SphericalHarmonicTransform(b, grid=grid, analysis="least_squares")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fsh.QuadratureWarning)  # at 4b² exact weights hardly exist; errors tell
        return fsh.SphericalHarmonicTransform(b, grid=grid)


class Subject:
    """A star-shaped mesh about its centre, scaled to a diagonal of 1, and how far reconstructions are from it."""

    def __init__(self, mesh: MeshArrays, center: np.ndarray, points: int, *, clouds: bool) -> None:
        self.mesh = MeshArrays((mesh.vertices - center) / mesh.diagonal, mesh.triangles)
        self.volume = self._volume()
        self.points = PointArrays(area_samples(self.mesh, points)[0])
        self.cloud: tuple[cKDTree, np.ndarray] | None = None
        if clouds:
            cloud = area_samples(self.mesh, CLOUD)[0]
            size = np.linalg.norm(cloud, axis=1)
            self.cloud = cKDTree(cloud / size[:, None]), size

    def _volume(self) -> float | None:
        """Return the enclosed volume; None: that of what is seen from outside is another, or there is none."""
        directions = fsh.fibonacci_grid(20_000).directions
        radii = sample_radial(self.mesh, directions, ORIGIN, behaviour="outermost", fillable=1).radii
        outside, inside = 4 / 3 * np.pi * float(np.mean(radii**3)), enclosed_volume(self.mesh)
        return inside if inside is not None and abs(inside / outside - 1) < 0.05 else None

    def radii(self, directions: np.ndarray) -> np.ndarray:
        """Return distances along directions, by rays or from the cloud."""
        if self.cloud is None:
            return sample_radial(self.mesh, directions, ORIGIN, behaviour="outermost").radii
        distance, near = self.cloud[0].query(directions, k=8)
        weight = 1 / np.maximum(distance, 1e-9)
        return np.asarray((weight * self.cloud[1][near]).sum(axis=1) / weight.sum(axis=1))

    def coefficients(self, method: str, b: int, turn: np.ndarray) -> np.ndarray:
        """Return the coefficients of the turned mesh, turned back."""
        plan = transform(method, b)
        # A ray along ω meets R·mesh where one along Rᵀω meets the mesh.
        found = plan.forward(self.radii(plan.grid.directions @ turn))
        return np.asarray(fsh.rotate_coefficients(found, turn.T))

    def errors(self, coefficients: np.ndarray) -> tuple[float, float, float]:
        """Return RMSE, MAE and volume error of a reconstruction; nan: it is not known what volume the mesh has."""
        shape = decoded(coefficients)
        there = fsh.vertex_distances(shape, self.mesh)
        back = fsh.vertex_distances(self.points, shape)
        share = vertex_areas(shape)
        square = (share @ there**2 + np.mean(back**2)) / 2
        mean = (share @ there + back.mean()) / 2
        volume = RadialShape(coefficients, ORIGIN).volume
        return float(np.sqrt(square)), float(mean), abs(volume / self.volume - 1) if self.volume else np.nan


def decoded(coefficients: np.ndarray) -> MeshArrays:
    """Return the surface on an icosphere."""
    directions, triangles = sphere_mesh(max(10_000, 6 * len(coefficients)))
    return MeshArrays(fsh.evaluate(coefficients, directions)[:, None] * directions, triangles)


def vertex_areas(mesh: MeshArrays) -> np.ndarray:
    """Return the share of the area that is nearest to each vertex, roughly: a third of the triangles around it."""
    area = triangle_areas(mesh.vertices[mesh.triangles])
    share = np.bincount(mesh.triangles.ravel(), np.repeat(area, 3), minlength=len(mesh.vertices))
    return np.asarray(share / share.sum())


def subject(path: Path, points: int, *, clouds: bool) -> Subject | None:
    """Read a mesh; None: it is none, or not star-shaped."""
    try:
        mesh = read_geometry_arrays(path)
        if not isinstance(mesh, MeshArrays):
            return None
        mesh = weld(mesh)
        center = star_center(mesh).center
        seen = sample_radial(mesh, fsh.fibonacci_grid(4096).directions, center, behaviour="outermost", fillable=1)
    except (fsh.GeometryError, OSError) as error:
        print(f"{path.name}: {error}")
        return None
    return None if max(seen.multiple, seen.missed) > 0.02 else Subject(mesh, center, points, clouds=clouds)


def measure(task: Task) -> tuple[str, dict[str, np.ndarray], dict[int, float]] | None:
    """Return errors (1 + rotations, 3) by method and bandwidth, upright first, and seconds; None: not star-shaped."""
    body = subject(task.path, task.points, clouds=task.clouds)
    if body is None:
        return None
    turns = np.concatenate((np.eye(3)[None], Rotation.random(task.rotations, random_state=task.seed).as_matrix()))
    errors, seconds = {}, {}
    for place, b in enumerate(task.bandwidths):
        start = time.process_time()
        poses = turns if place == 0 else turns[:1]
        for method in METHODS:
            found = [body.errors(body.coefficients(method, b, turn)) for turn in poses]
            errors[f"{method} b={b}"] = np.array(found)
        seconds[b] = time.process_time() - start
    return task.path.stem, errors, seconds


def intervals(values: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of (shapes, k) and 2000 bootstrap draws of them: whole shapes, so that columns stay paired."""
    if not len(values):  # no volume of any shape is known
        return np.full(values.shape[1], np.nan), np.full((1, values.shape[1]), np.nan)
    draws = np.random.default_rng(seed).integers(0, len(values), (2000, len(values)))
    return values.mean(axis=0), values[draws].mean(axis=1)


def bounds(draws: np.ndarray) -> list[float]:
    """Return the limits of a 95 % interval."""
    return [float(value) for value in np.quantile(draws, (0.025, 0.975))]


def table_1(found: dict[str, dict[str, np.ndarray]], b: int, seed: int) -> dict[str, dict[str, Any]]:
    """Print and return |G1 - G2|, mean over shapes and rotations, with intervals over shapes."""
    results: dict[str, dict[str, Any]] = {}
    rows = []
    for place, metric in enumerate(METRICS):
        change = np.array(
            [
                [np.abs(shape[f"{method} b={b}"][1:, place] - shape[f"{method} b={b}"][0, place]) for method in METHODS]
                for shape in found.values()
            ]
        ).mean(axis=2)
        change = change[np.isfinite(change).all(axis=1)]
        means, draws = intervals(change, seed)
        results[metric] = {"shapes": len(change)}
        cells: list[object] = [1e3 * mean for mean in means]
        for column, method in enumerate(METHODS):
            results[metric][method] = {"mean": means[column], "interval": bounds(draws[:, column])}
            if column:
                low, high = bounds(draws[:, 0] / draws[:, column])
                ratio = means[0] / means[column]
                results[metric][f"{METHODS[0]} over {method}"] = {"ratio": ratio, "interval": [low, high]}
                cells.append(f"{ratio:.1f} ({low:.1f}-{high:.1f})")
        rows.append((metric, *cells))
    closed = results["VE"]["shapes"]
    print(f"\nTable 1: mean |G1 - G2| x 1e3 and ESH over each, {len(found)} shapes (VE: {closed}), b = {b}")
    print(table(("", *METHODS, *(f"ESH / {method}" for method in METHODS[1:])), rows))
    return results


def table_2(found: dict[str, dict[str, np.ndarray]], bandwidths: tuple[int, ...], seed: int) -> dict[str, Any]:
    """Print and return the errors themselves, mean over the shapes of G1, and how far below ESH's they are."""
    rows, results = [], {}
    for b in bandwidths:
        errors = np.array([[shape[f"{method} b={b}"][0] for method in METHODS] for shape in found.values()])
        for column, method in enumerate(METHODS):
            cells: list[object] = []
            result: dict[str, Any] = {}
            for place, metric in enumerate(METRICS):
                values = errors[np.isfinite(errors[:, 0, place]), :, place]
                pair = np.column_stack((values[:, column], values[:, 0] - values[:, column]))
                means, draws = intervals(pair, seed)
                below = bounds(draws[:, 1])
                result[metric] = {"mean": means[0], "below_esh": means[1], "interval": below}
                sign = "" if column == 0 else " -" if below[0] > 0 else " +" if below[1] < 0 else " ~"
                cells.append(f"{1e3 * means[0]:.3f}{sign}")
            results[f"{method} b={b}"] = result
            rows.append((f"{method}, b = {b}", *cells))
    print("\nTable 2: mean error x 1e3 of G1 (- below ESH, + above, ~ the 95 % interval of the difference holds 0)")
    print(table(("", *METRICS), rows))
    return results


def picture(body: Subject, name: str, b: int, output: tuple[Path, str]) -> None:
    """Draw Fig. 9: deviation of both reconstructions, upright and turned by 90 degrees, along the shortest side."""
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    panels = {
        f"{method}{pose}": decoded(body.coefficients(method, b, rotation))
        for pose, rotation in (("", np.eye(3)), (", input turned by 90°", turn))
        for method in ("ESH 4b²", "SFG 4b²")
    }
    deviations = [1e3 * fsh.vertex_distances(shape, body.mesh) for shape in panels.values()]
    top = float(np.quantile(np.concatenate(deviations), 0.99))
    order = np.argsort(np.ptp(body.mesh.vertices, axis=0))  # shortest first: the line of sight
    view = Rotation.from_euler("yx", (30, 20), degrees=True).as_matrix()
    everything = np.concatenate([shape.vertices for shape in panels.values()])[:, order[[2, 1, 0]]] @ view.T
    figure, places = plt.subplots(1, len(panels), figsize=(14, 4.2), layout="constrained")
    for axes, (title, shape), values in zip(places, panels.items(), deviations, strict=True):
        # The middle one up, a little from the side; shaded by the angle to a light at the eye.
        points = shape.vertices[:, order[[2, 1, 0]]] @ view.T
        corners = points[shape.triangles]
        normals = triangle_normals(corners)
        light = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        color = plt.get_cmap("viridis")(np.minimum(values[shape.triangles].mean(axis=1) / top, 1))
        color[:, :3] *= (0.45 + 0.55 * light)[:, None]
        far_first = np.argsort(corners[:, :, 2].mean(axis=1))
        faces = PolyCollection(
            corners[far_first, :, :2], facecolors=color[far_first], edgecolors="face", linewidths=0.3
        )
        axes.add_collection(faces)
        axes.set(aspect="equal", xlim=_limits(everything[:, 0]), ylim=_limits(everything[:, 1]))
        axes.set_axis_off()
        axes.set_title(f"{title}\nmean deviation {values.mean():.2f}", fontsize=10)
    scale = plt.cm.ScalarMappable(plt.Normalize(0, top), "viridis")
    figure.colorbar(scale, ax=places, shrink=0.8, label="deviation, thousandths of the diagonal", extend="max")
    figure.suptitle(f"{name}, {b} degrees")
    save_figure(output[0], f"fig9_deviation{output[1]}", figure)


def _limits(values: np.ndarray) -> tuple[float, float]:
    margin = 0.03 * float(np.ptp(values))
    return float(values.min()) - margin, float(values.max()) + margin


def chart(results: dict[str, dict[str, Any]], output: tuple[Path, str]) -> None:
    """Draw Table 1 with its intervals."""
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.6))
    for axes, metric in zip(panels, METRICS, strict=True):
        means = np.array([1e3 * results[metric][method]["mean"] for method in METHODS])
        limits = np.array([results[metric][method]["interval"] for method in METHODS]).T * 1e3
        # Points, since a bar has no foot on a logarithmic axis.
        for place, color in enumerate(("#b5533c", *["#1f5fa8"] * 3)):
            reach = np.abs(limits[:, [place]] - means[place])
            axes.errorbar(place, means[place], yerr=reach, fmt="o", color=color, ecolor=color, capsize=4)
        axes.set_yscale("log")
        axes.set_title(f"|{metric}(G1) − {metric}(G2)| · 1000", fontsize=10)
        axes.set_xticks(range(len(METHODS)), METHODS, fontsize=8)
        axes.set_xlim(-0.5, len(METHODS) - 0.5)
        if not results[metric]["shapes"]:
            axes.text(0.5, 0.5, "of no shape known", transform=axes.transAxes, ha="center")
        axes.grid(axis="y", alpha=0.3)
    panels[0].set_ylabel("mean over shapes, 95 % interval")
    figure.tight_layout()
    save_figure(output[0], f"table1{output[1]}", figure)


def main() -> None:
    """Measure, print, draw."""
    arguments = parser(__doc__, "star_shapes")
    arguments.add_argument("--shapes", type=Path, default=SAMPLES, help="folder of meshes (default: samples/)")
    arguments.add_argument("--clouds", action="store_true", help="sample clouds of points instead of rays")
    arguments.add_argument("--degrees", type=int, nargs="+", help="(default: 32; with --full 32 64 128)")
    arguments.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = arguments.parse_args()
    bandwidths = tuple(options.degrees or ((32, 64, 128) if options.full else (32,)))
    kinds = {".off", ".ply", ".obj", ".stl"}
    paths = [path for path in sorted(options.shapes.rglob("*")) if path.suffix.lower() in kinds]
    paths = [path for path in paths if "broken" not in path.parts]
    if not options.full:
        paths = paths[:: -(-len(paths) // 12) or 1]
    rotations, points = (5, 20_000) if options.full else (2, 10_000)
    tasks = [Task(path, bandwidths, rotations, options.seed, options.clouds, points) for path in paths]
    for b in bandwidths:  # solved once, then found in the cache of weights by all workers
        transform("SFG 4b²", b), transform("SFG 6b²", b)
    start = time.monotonic()
    with ProcessPoolExecutor(options.workers, initializer=_single_threaded) as pool:
        done = [result for result in pool.map(measure, tasks) if result is not None]
    if not done:
        raise ValueError(f"no star-shaped mesh below {options.shapes}")
    found = {name: errors for name, errors, _ in done}
    spent = {b: sum(seconds[b] for _, _, seconds in done) for b in bandwidths}
    results = {
        "shapes": sorted(found),
        "sampled": "clouds" if options.clouds else "rays",
        "rotations": rotations,
        "residual of the weights": {f"SFG 4b² b={b}": _residual(b) for b in bandwidths},
        "cpu_seconds": spent,
        "table_1": table_1(found, bandwidths[0], options.seed),
        "table_2": table_2(found, bandwidths, options.seed),
        "errors by shape, method and pose": found,
    }
    for b in bandwidths:
        print(f"b = {b}: {spent[b]:.0f} s of CPU; the analytic weights at 4b² miss Eq. (8) by {_residual(b):.1e}")
    print(f"{len(found)} of {len(paths)} meshes are star-shaped; {time.monotonic() - start:.0f} s")
    output = options.output, "_clouds" if options.clouds else ""
    save_results(output[0], f"table1_table2{output[1]}", results)
    chart(results["table_1"], output)
    # The shape that shows most of what the tables are about: largest change of ESH's error with the pose.
    change = {name: float(np.ptp(errors[f"{METHODS[0]} b={bandwidths[0]}"][:, 0])) for name, errors in found.items()}
    name = max(change, key=lambda stem: change[stem])
    body = subject(next(path for path in paths if path.stem == name), points, clouds=options.clouds)
    assert body is not None
    picture(body, name, bandwidths[0], output)


def _residual(b: int) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fsh.QuadratureWarning)
        return fsh.analytic_weights(fsh.fibonacci_grid(4 * b * b), b).residual


def _single_threaded() -> None:
    os.environ["OMP_NUM_THREADS"] = "1"


if __name__ == "__main__":
    run(main)
