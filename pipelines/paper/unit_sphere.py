"""Fig. 6 and 7 of the paper: the unit sphere through forward and inverse transform with three kinds of weights.

r = 1 is a function of degree 0 alone; whatever else comes back is the weights' doing. The paper takes n = 4300 for
degrees 0 ... 31; the same at 4b², where exact weights hardly exist, at the 4(b + 2)² of its published code, and at the
6b² that this package takes by default.

    python pipelines/paper/unit_sphere.py
"""

from __future__ import annotations

import warnings

import numpy as np
from _common import parser, plt, run, save_figure, save_results, table

import fsh3d_o3d as fsh

BANDWIDTH = 32


def main() -> None:
    """Transform, print, draw."""
    options = parser(__doc__, "unit_sphere").parse_args()
    b = BANDWIDTH
    directions = fsh.equiangular_grid(90 if options.full else 45).directions
    side = int(np.sqrt(len(directions)))
    results: dict[str, dict[str, object]] = {}
    rows = []
    figure, panels = plt.subplots(2, 3, figsize=(14, 6))
    for count in (4300, 4 * b * b, 4 * (b + 2) ** 2, 6 * b * b):
        grid = fsh.fibonacci_grid(count)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fsh.QuadratureWarning)  # 4b²: the residual is printed
            analytic = fsh.analytic_weights(grid, b)
        sets = {"analytic": analytic.weights, "equal": fsh.equal_weights(grid), "area": fsh.area_weights(grid)}
        results[f"n={count}"] = {}
        for place, (name, weights) in enumerate(sets.items()):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", fsh.QuadratureWarning)
                transform = fsh.SphericalHarmonicTransform(b, grid=grid, weights=weights)
                wide = fsh.SphericalHarmonicTransform(2 * b, grid=grid, weights=weights)
            coefficients = transform.forward(np.ones(count))
            error = fsh.evaluate(coefficients, directions) - 1
            sums = wide.forward(np.ones(count)) / np.sqrt(4 * np.pi)  # ŝ(l, m), 1 at l = 0 and 0 elsewhere
            sums[0] -= 1
            figures = {
                "error_rms": float(np.sqrt(np.mean(error**2))),
                "error_max": float(np.abs(error).max()),
                "deviation_max": float(np.abs(sums).max()),
            }
            results[f"n={count}"][name] = figures
            rows.append((f"n = {count}, {name}", *figures.values()))
            if count == 4300:
                worst = max(float(np.abs(error).max()), 1e-17)
                power = int(np.floor(np.log10(worst)))
                image = panels[0, place].imshow(
                    error.reshape(side, side) / 10.0**power,
                    cmap="RdBu",
                    vmin=-worst / 10.0**power,
                    vmax=worst / 10.0**power,
                    extent=(0, 360, 180, 0),
                    aspect="auto",
                )
                title = f"{name} weights, n = {count}: error of r = 1, times 1e{-power}"
                panels[0, place].set_title(title, fontsize=10)
                panels[0, place].set(xlabel="longitude, °", xticks=range(0, 361, 90), yticks=range(0, 181, 45))
                figure.colorbar(image, ax=panels[0, place])
                degree = fsh.degrees_and_orders(2 * b)[0]
                panels[1, place].semilogy(degree, np.maximum(np.abs(sums), 1e-18), ".", ms=2, color="#1f5fa8")
                panels[1, place].set(xlabel="degree l", ylabel="|ŝ(l, m) − δ|", ylim=(1e-18, 1))
    panels[0, 0].set_ylabel("colatitude, °")
    figure.tight_layout()
    print(table(("degrees 0 ... 31", "error RMS", "error max", "deviation from Eq. (8)"), rows))
    save_figure(options.output, "fig6_fig7_unit_sphere", figure)
    save_results(options.output, "fig6_fig7_unit_sphere", results)


if __name__ == "__main__":
    run(main)
