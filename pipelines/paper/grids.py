"""Fig. 3 of the paper: five grids of points on the sphere, drawn, and how even they are.

The paper's argument starts here: points of an equiangular grid crowd at the poles, those of the others do not. The
figures say how much: the smallest distance between two points and the largest distance of any direction from a point,
both over what a hexagonal lattice of as many points would have, and the spread of the Voronoi areas.

    python pipelines/paper/grids.py
"""

from __future__ import annotations

import numpy as np
from _common import parser, plt, run, save_figure, save_results, table
from scipy.spatial import SphericalVoronoi, cKDTree
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh


def evenness(grid: fsh.SphericalGrid) -> dict[str, float]:
    """Return uniformity figures of a grid without its repeated points."""
    points = np.unique(np.round(grid.directions, 12), axis=0)
    count = len(points)
    ideal = np.sqrt(8 * np.pi / (np.sqrt(3) * count))  # distance of neighbours in a hexagonal lattice
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    cells = SphericalVoronoi(points)
    holes = cKDTree(points).query(cells.vertices)[0]
    areas = cells.calculate_areas() * count / (4 * np.pi)
    return {
        "points": count,
        "minimum_distance": 2 * np.arcsin(nearest.min() / 2) / ideal,
        "covering_radius": 2 * np.arcsin(holes.max() / 2) / (ideal / np.sqrt(3)),
        "area_minimum": areas.min(),
        "area_maximum": areas.max(),
        "area_deviation": areas.std(),
    }


def main() -> None:
    """Draw and measure."""
    options = parser(__doc__, "grids").parse_args()
    b = 32 if options.full else 16
    count = 4 * b * b
    grids = [
        fsh.equiangular_grid(b),
        fsh.fibonacci_grid(count),
        fsh.healpix_grid(round(np.sqrt(count / 12))),
        fsh.icosahedral_grid(3 if options.full else 2),
        fsh.cube_grid(round(np.sqrt(count / 6)) + 1),
    ]
    results = {grid.name: evenness(grid) for grid in grids}
    rows = [(name, *values.values()) for name, values in results.items()]
    print(table(("grid", "points", "min. distance", "covering", "area min", "area max", "area std"), rows))
    print("Distances over those of a hexagonal lattice; areas over their mean.")
    figure = plt.figure(figsize=(16, 3.7))
    view = Rotation.from_euler("zx", (-45, -55), degrees=True).as_matrix()  # from above, so that a pole shows
    for place, grid in enumerate(grids):
        axes = figure.add_subplot(1, 5, place + 1, aspect="equal")
        x, y, z = view @ grid.directions.T
        axes.add_patch(plt.Circle((0, 0), 1, facecolor="#f2f4f7", edgecolor="#c8ced6"))
        axes.scatter(x[z > 0], y[z > 0], s=5000 / len(grid), c="#1f5fa8", linewidths=0)
        axes.set_axis_off()
        axes.set_title(f"{grid.name}, {len(grid)} points", fontsize=10)
    figure.tight_layout()
    save_figure(options.output, "fig3_grids", figure)
    save_results(options.output, "fig3_grids", results)


if __name__ == "__main__":
    run(main)
