"""Fig. 4 and 5 of the paper: the analytic weights at 16 and 32 degrees, beside Driscoll-Healy and area weights.

Fig. 4 claims that "the deviation between our analytic weight and the DH weight fluctuates on the order of 1e-16". The
two belong to different grids, so their values cannot be compared point by point, and the text does not say what was.
What can be compared is computed here: (a) Eq. (11) solved on the equiangular grid with one weight for each ring,
against the closed formula of Driscoll and Healy: the same to rounding, since 2b conditions determine 2b rings; (b) the
same with a weight for each point, as on the Fibonacci grid: underdetermined, so the minimum-norm solution is another
one, just as exact; (c) what each rule does to the harmonics of degree 1 ... 2b - 1, which all are to send to zero.

    python pipelines/paper/weights.py
"""

from __future__ import annotations

import warnings

import numpy as np
from _common import parser, plt, run, save_figure, save_results, table

import fsh3d_o3d as fsh


def spectrum(grid: fsh.SphericalGrid, weights: np.ndarray, b: int) -> float:
    """Return max |sum_j w_j Y(w_j) - sqrt(4 pi) delta| over degrees 0 ... 2b - 1."""
    transform = fsh.SphericalHarmonicTransform(2 * b, grid=grid, weights=weights)
    sums = transform.forward(np.ones(len(grid)))
    sums[0] -= np.sqrt(4 * np.pi)
    return float(np.abs(sums).max())


def rings(grid: fsh.SphericalGrid, b: int) -> np.ndarray:
    """Solve the conditions for one weight on each of the 2b rings, and spread it over the ring's 2b points."""
    heights = grid.directions[:: 2 * b, 2]
    conditions = np.polynomial.legendre.legvander(heights, 2 * b - 1).T
    right = np.zeros(2 * b)
    right[0] = 4 * np.pi
    return np.repeat(np.linalg.solve(conditions, right) / (2 * b), 2 * b)


def main() -> None:
    """Compare, print, draw."""
    options = parser(__doc__, "weights").parse_args()
    results: dict[str, object] = {}
    rows = []
    figure, panels = plt.subplots(2, 3, figsize=(14, 6.5))
    for line, b in zip(panels, (16, 32), strict=True):
        equiangular, fibonacci = fsh.equiangular_grid(b), fsh.fibonacci_grid(6 * b * b)
        closed = fsh.driscoll_healy_weights(b)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fsh.QuadratureWarning)  # the residual is printed
            solved = fsh.analytic_weights(equiangular, b)
            few = fsh.analytic_weights(fsh.fibonacci_grid(4 * b * b), b)
        own = fsh.analytic_weights(fibonacci, b)
        area = fsh.area_weights(fibonacci)
        by_ring = np.abs(rings(equiangular, b) - closed).max() / closed.max()
        difference = np.abs(solved.weights - closed).max() / closed.max()
        results[f"b={b}"] = {
            "one_weight_a_ring_minus_driscoll_healy": by_ring,
            "minimum_norm_on_equiangular_minus_driscoll_healy": difference,
            "residual_minimum_norm_on_equiangular": solved.residual,
            "residual_driscoll_healy": spectrum(equiangular, closed, b),
            "residual_analytic_6b2": spectrum(fibonacci, own.weights, b),
            "residual_analytic_4b2": few.residual,
            "residual_area": spectrum(fibonacci, area, b),
            "analytic_over_equal": [
                own.minimum * len(fibonacci) / (4 * np.pi),
                own.maximum * len(fibonacci) / (4 * np.pi),
            ],
            "area_over_equal": [area.min() * len(fibonacci) / (4 * np.pi), area.max() * len(fibonacci) / (4 * np.pi)],
        }
        rows += [
            (f"b={b}: one weight a ring, solved, - Driscoll-Healy, relative", by_ring),
            ("  one weight a point, minimum norm, - Driscoll-Healy, relative", difference),
            ("  its residual", solved.residual),
            ("  residual of Driscoll-Healy weights, 4b^2 points", spectrum(equiangular, closed, b)),
            ("  residual of analytic weights, 6b^2 Fibonacci points", spectrum(fibonacci, own.weights, b)),
            ("  residual of analytic weights, 4b^2 Fibonacci points", few.residual),
            ("  residual of area weights, 6b^2 Fibonacci points", spectrum(fibonacci, area, b)),
        ]
        for axes, grid, weights, title in (
            (line[0], equiangular, closed, "equiangular grid, Driscoll-Healy"),
            (line[1], fibonacci, own.weights, "Fibonacci grid, analytic"),
            (line[2], fibonacci, area, "Fibonacci grid, area"),
        ):
            axes.plot(grid.directions[:, 2], weights * len(grid) / (4 * np.pi), ".", ms=2, mew=0, color="#1f5fa8")
            axes.set(
                title=f"{title} weights, b = {b}", xlabel="z", ylabel="weight · n / 4π", xticks=(-1, -0.5, 0, 0.5, 1)
            )
        for axes in line[1:]:
            axes.set_ylim(0.9, 1.12)
    figure.tight_layout()
    print(table(("", "figure"), rows))
    save_figure(options.output, "fig5_weights", figure)
    save_results(options.output, "fig4_fig5_weights", results)


if __name__ == "__main__":
    run(main)
