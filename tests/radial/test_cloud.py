import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from fsh3d_o3d.errors import CoverageError, GeometryError
from fsh3d_o3d.geometry.arrays import PointArrays
from fsh3d_o3d.radial.angular_cells import AngularCells, largest_empty_cap
from fsh3d_o3d.radial.cloud import cloud_center, fit_radial_cloud
from fsh3d_o3d.radial.robust_fit import bending, likely_penalty, robust_scale
from fsh3d_o3d.sphere.grids import fibonacci_grid
from fsh3d_o3d.sphere.harmonics import degrees_and_orders
from fsh3d_o3d.sphere.transform import evaluate

ORIGIN = np.zeros(3)
GRID = fibonacci_grid(5000)


def random_directions(rng, n):
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def rough(rng, b, decay=2.0, amplitude=0.1):
    """Coefficients of a function about 1, of root mean square ``amplitude`` about it."""
    degree, _ = degrees_and_orders(b)
    coefficients = rng.normal(size=b * b) * (1.0 + degree) ** -decay
    coefficients[0] = 0
    coefficients *= amplitude * np.sqrt(4 * np.pi) / np.linalg.norm(coefficients)
    coefficients[0] = np.sqrt(4 * np.pi)
    return coefficients


def sampled(rng, coefficients, n, noise=0.01, outliers=0.05, hole=0.0):
    """Points of a radial function, but none within ``hole`` degrees of +z that are not outliers."""
    directions = random_directions(rng, n)
    bad = rng.random(n) < outliers
    keep = bad | (directions[:, 2] <= np.cos(np.radians(hole)))
    directions, bad = directions[keep], bad[keep]
    radii = evaluate(coefficients, directions) + noise * rng.normal(size=len(bad))
    radii[bad] = rng.uniform(0.3, 2.0, bad.sum())
    return directions * radii[:, None]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def fitted_error(fit, truth):
    return evaluate(fit.coefficients, GRID) - evaluate(truth, GRID)


def ellipsoid(rng, axes, n):
    directions = random_directions(rng, n)
    return directions / np.linalg.norm(directions / axes, axis=1)[:, None]


def test_a_sphere_is_found_to_rounding():
    rng = np.random.default_rng(0)
    center = np.array([3.0, -4.0, 12.0])
    fit = fit_radial_cloud(PointArrays(center + 2.5 * random_directions(rng, 3000)), 8, center)
    # Rounding of the points, and the floor of 1e-10 at which reweighting stops.
    np.testing.assert_allclose(evaluate(fit.coefficients, GRID), 2.5, rtol=1e-9)
    assert fit.converged and fit.inliers == 1 and fit.scale < 1e-8
    np.testing.assert_array_equal(fit.center, center)


def test_an_exact_band_limited_function_is_found():
    rng = np.random.default_rng(1)
    truth = rough(rng, 12)
    fit = fit_radial_cloud(PointArrays(sampled(rng, truth, 20000, 0, 0)), 12, ORIGIN)
    # Without noise only the steps' tolerance and, for resampling, the averaging over neighbourhoods remain.
    assert rms(fitted_error(fit, truth)) < 1e-7


def test_an_ellipsoid_is_found_through_noise_and_outliers():
    rng = np.random.default_rng(2)
    axes = np.array([1.0, 1.3, 0.8])
    points = ellipsoid(rng, axes, 20000) * (1 + 0.01 * rng.normal(size=(20000, 1)))
    points[:2000] = rng.uniform(-2, 2, (2000, 3))
    fit = fit_radial_cloud(PointArrays(points), 16, ORIGIN)
    truth = 1 / np.linalg.norm(GRID.directions / axes, axis=1)
    # 0.01 sqrt(256 / 18000) = 0.0012 is what the noise alone costs plain least squares on the good points.
    assert rms(evaluate(fit.coefficients, GRID) - truth) < 0.0016
    assert 0.88 < fit.inliers < 0.94  # 90 %, and those outliers that happen to lie on the surface
    assert fit.scale == pytest.approx(0.0105, rel=0.1)  # 0.01 of a radius that is 1.04 on average


@pytest.mark.parametrize("decay", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("outliers", [0.05, 0.2])
def test_fits_are_nearly_as_good_as_least_squares_that_knows_the_outliers(decay, outliers):
    rng = np.random.default_rng(3)
    b, n = 12, 20000
    truth = rough(rng, b, decay)
    fit = fit_radial_cloud(PointArrays(sampled(rng, truth, n, outliers=outliers)), b, ORIGIN)
    best = 0.01 * np.sqrt(b * b / ((1 - outliers) * n))
    # 144 coefficients: the error of one draw scatters by 6 % about its mean.
    assert rms(fitted_error(fit, truth)) < 1.1 * 1.12 * best
    assert fit.scale == pytest.approx(0.01, rel=0.05)
    assert fit.converged


def test_what_is_smooth_is_fitted_better_than_without_smoothing():
    rng = np.random.default_rng(4)
    truth = rough(rng, 24, decay=4.0)
    cloud = PointArrays(sampled(rng, truth, 20000))
    chosen, plain = (fit_radial_cloud(cloud, 24, ORIGIN, smoothness=s) for s in (None, 0.0))
    assert plain.smoothness == 0 and chosen.smoothness > 0
    assert rms(fitted_error(chosen, truth)) < 0.6 * rms(fitted_error(plain, truth))


@pytest.mark.parametrize("decay", [2.0, 3.0])
def test_a_hole_is_filled_smoothly(decay):
    rng = np.random.default_rng(5)
    truth = rough(rng, 20, decay)
    fit = fit_radial_cloud(PointArrays(sampled(rng, truth, 30000, hole=25)), 20, ORIGIN)
    error = fitted_error(fit, truth)
    inside = GRID.directions[:, 2] > np.cos(np.radians(25))
    # 0.1 is the amplitude of the function itself; rough functions cannot be known inside the hole.
    assert rms(error[inside]) < 0.03
    assert rms(error[~inside]) < 0.0015
    assert fit.empty_cap == pytest.approx(25, abs=8)  # outliers near the surface may lie in its rim
    assert fit.empty_direction[2] > 0.98


def test_density_may_vary_a_hundredfold():
    rng = np.random.default_rng(6)
    truth = rough(rng, 12)
    points = sampled(rng, truth, 40000)
    points = points[rng.random(len(points)) < np.where(points[:, 0] > 0, 1.0, 0.03)]
    fit = fit_radial_cloud(PointArrays(points), 12, ORIGIN)
    # 600 points on the sparse half: 0.01 sqrt(144 / 1200) = 0.0035 there.
    assert rms(fitted_error(fit, truth)) < 0.0045


def test_a_crowd_of_outliers_in_one_place_is_not_followed():
    rng = np.random.default_rng(7)
    truth = rough(rng, 16)
    points = sampled(rng, truth, 30000)
    points[:1500] = [0.3, 0.2, 1.4] + 0.05 * rng.normal(size=(1500, 3))
    fit = fit_radial_cloud(PointArrays(points), 16, ORIGIN)
    assert rms(fitted_error(fit, truth)) < 0.0015


def test_edges_too_sharp_for_the_bandwidth_are_not_outliers():
    rng = np.random.default_rng(8)
    points = rng.uniform(-1, 1, (30000, 3))
    axis = rng.integers(0, 3, 30000)
    points[np.arange(30000), axis] = np.sign(points[np.arange(30000), axis])
    fit = fit_radial_cloud(PointArrays(points), 16, ORIGIN)
    assert fit.inliers > 0.97


@given(seed=st.integers(0, 1000), exponent=st.sampled_from([-30, -3, 0, 4, 30]))
@settings(max_examples=5, deadline=None)
def test_fits_turn_and_scale_with_the_cloud(seed, exponent):
    rng = np.random.default_rng(seed)
    truth = rough(rng, 8)
    points = sampled(rng, truth, 3000)
    fit = fit_radial_cloud(PointArrays(points), 8, ORIGIN)
    turn, scale = Rotation.random(random_state=seed).as_matrix(), 10.0**exponent
    moved = fit_radial_cloud(PointArrays(scale * points @ turn.T), 8, ORIGIN)
    values = evaluate(moved.coefficients / scale, GRID.directions @ turn.T)
    # Cells do not turn with the cloud: verdicts on single points may differ, by a part of the error of 0.0015.
    assert rms(values - evaluate(fit.coefficients, GRID)) < 0.001
    assert moved.scale / scale == pytest.approx(fit.scale, rel=0.05)


def test_order_and_threads_do_not_matter():
    rng = np.random.default_rng(9)
    points = sampled(rng, rough(rng, 8), 4000)
    fits = [fit_radial_cloud(PointArrays(points), 8, ORIGIN, threads=t) for t in (1, 2)]
    np.testing.assert_array_equal(fits[0].coefficients, fits[1].coefficients)
    shuffled = fit_radial_cloud(PointArrays(rng.permutation(points)), 8, ORIGIN)
    # Sums in another order, and the tolerance of the steps, 0.3 % of the standard error.
    np.testing.assert_allclose(shuffled.coefficients, fits[0].coefficients, atol=2e-5)


def test_a_far_offset_costs_only_its_rounding():
    rng = np.random.default_rng(10)
    points, offset = sampled(rng, rough(rng, 8), 4000), np.array([1e6, -2e6, 3e6])
    near, far = (fit_radial_cloud(PointArrays(points + o), 8, o) for o in (ORIGIN, offset))
    np.testing.assert_allclose(far.coefficients, near.coefficients, atol=1e-6)
    moved = cloud_center(PointArrays(points + offset)) - offset
    np.testing.assert_allclose(moved, cloud_center(PointArrays(points)), atol=1e-4)  # its steps end at 1e-4


def test_half_a_sphere_is_refused_with_the_size_of_the_hole():
    points = random_directions(np.random.default_rng(11), 20000)
    half = PointArrays(points[points[:, 0] > 0])
    with pytest.raises(
        CoverageError, match=r"cap of (89|90)\.\d degrees .*-1.* up to 60 degrees .*one side.*fsh.reconstruct"
    ):
        fit_radial_cloud(half, 8, ORIGIN)
    assert fit_radial_cloud(
        PointArrays(points[points[:, 0] > -0.5]), 4, ORIGIN, max_hole=70
    ).empty_cap == pytest.approx(60, abs=1)


def test_a_hole_full_of_outliers_is_a_hole():
    rng = np.random.default_rng(12)
    points = sampled(rng, rough(rng, 10), 30000, outliers=0.2, hole=70)
    with pytest.raises(CoverageError, match="no points but outliers"):
        fit_radial_cloud(PointArrays(points), 10, ORIGIN, max_hole=50)


def test_points_on_one_side_are_refused():
    points = random_directions(np.random.default_rng(13), 5000) + np.array([10, 0, 0])
    with pytest.raises(CoverageError, match=r"cap of 17\d\.\d degrees"):
        fit_radial_cloud(PointArrays(points), 4, ORIGIN)


def test_too_few_points_name_the_largest_bandwidth():
    rng = np.random.default_rng(14)
    points = random_directions(rng, 1000)
    with pytest.raises(GeometryError, match=r"too few for bandwidth 32, .* use at most bandwidth 22"):
        fit_radial_cloud(PointArrays(points), 32, ORIGIN)
    fit_radial_cloud(PointArrays(points), 22, ORIGIN)
    copies = PointArrays(np.repeat(points[:50], 1000, axis=0))
    with pytest.raises(GeometryError, match=r"50 different directions .* use at most bandwidth"):
        fit_radial_cloud(copies, 16, ORIGIN)


def test_points_without_extent_or_direction_are_refused():
    same = PointArrays(np.ones((50, 3)))
    for call in (lambda: fit_radial_cloud(same, 2, ORIGIN), lambda: cloud_center(same)):
        with pytest.raises(GeometryError, match="coincide"):
            call()
    with pytest.raises(GeometryError, match="center"):
        fit_radial_cloud(PointArrays(np.ones((1, 3))), 2, np.ones(3))
    with pytest.raises(GeometryError, match="at least 4"):
        cloud_center(PointArrays(np.eye(3)))


def test_one_point_far_away_does_no_harm():
    points = random_directions(np.random.default_rng(22), 2000)
    cloud = PointArrays(np.concatenate([points, [[1e200, 0, 0]]]))
    np.testing.assert_allclose(cloud_center(cloud), 0, atol=1e-3)
    np.testing.assert_allclose(evaluate(fit_radial_cloud(cloud, 4, ORIGIN).coefficients, GRID), 1, rtol=1e-9)


@pytest.mark.parametrize("scale", [1e-300, 1e306])
def test_coordinates_at_the_limits_of_floats(scale):
    points = scale * random_directions(np.random.default_rng(23), 2000)
    values = evaluate(fit_radial_cloud(PointArrays(points), 2, ORIGIN).coefficients, GRID)
    np.testing.assert_allclose(values / scale, 1, rtol=1e-9)


def test_radii_beyond_floats_are_refused():
    points = 1.7e308 * random_directions(np.random.default_rng(24), 2000)
    with pytest.raises(GeometryError, match="too large for float64"):
        fit_radial_cloud(PointArrays(points), 2, ORIGIN)


def test_points_at_the_center_count_as_outliers():
    points = random_directions(np.random.default_rng(15), 2000)
    points[:500] = 0
    fit = fit_radial_cloud(PointArrays(points), 4, ORIGIN)
    np.testing.assert_allclose(evaluate(fit.coefficients, GRID), 1, rtol=1e-9)
    assert fit.inliers == 0.75


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"bandwidth": 0}, ValueError),
        ({"bandwidth": 2.5}, TypeError),
        ({"center": [0, 0]}, ValueError),
        ({"center": [0, 0, np.nan]}, ValueError),
        ({"smoothness": -1.0}, ValueError),
        ({"max_hole": 0.0}, ValueError),
        ({"max_hole": 91.0}, ValueError),
        ({"threads": 0}, ValueError),
        ({"cloud": np.zeros((5, 3))}, TypeError),
    ],
)
def test_bad_arguments_are_named(change, error):
    arguments = {"cloud": PointArrays(fibonacci_grid(500).directions), "bandwidth": 4, "center": ORIGIN} | change
    with pytest.raises(error, match=next(iter(change))):
        fit_radial_cloud(**arguments)


@given(seed=st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_the_largest_empty_cap_is_that_of_the_convex_hull(seed):
    rng = np.random.default_rng(seed)
    points = random_directions(rng, 600)
    points = points[points @ random_directions(rng, 1)[0] < 0.9]
    # Circumscribed circles of Delaunay triangles are the maximal empty caps, and hull faces are Delaunay triangles.
    radius, center = largest_empty_cap(points)
    truth = float(np.arccos(np.clip(-ConvexHull(points).equations[:, 3], -1, 1)).max())
    assert truth - 0.005 < radius <= truth + 1e-9
    assert np.arccos((points @ center).max()) == pytest.approx(radius, abs=1e-7)


@pytest.mark.parametrize("edge", [0.0, 0.4, -0.6, -0.9])
def test_the_largest_empty_cap_of_one_sided_clouds(edge, random_rotation):
    """As many directions are equally far from its centre as there are on the edge, and it may be larger than half."""
    angle = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    heights = np.linspace(-1, edge, 12)[1:, None] if edge else np.zeros((1, 1))  # a flat cloud is all edge
    across = np.sqrt(1 - heights**2)
    points = np.stack(np.broadcast_arrays(across * np.cos(angle), across * np.sin(angle), heights), axis=-1)
    directions = points.reshape(-1, 3) @ random_rotation.T
    radius, center = largest_empty_cap(directions)
    truth = np.arccos(edge)
    assert truth - 0.001 < radius <= truth + 1e-9
    assert np.arccos((directions @ center).max()) == pytest.approx(radius, abs=1e-7)
    if edge:
        assert center @ random_rotation[:, 2] > np.cos(0.001)


def test_cells_take_medians_and_sums_like_loops_do():
    rng = np.random.default_rng(16)
    directions, values = random_directions(rng, 2000), rng.normal(size=2000)
    cells = AngularCells.of(directions, 100)
    groups = [np.sort(values[cells.index == k]) for k in range(len(cells.count))]
    np.testing.assert_array_equal(cells.count, [len(g) for g in groups])
    # Values are kept to 1e-11 of their range times the number of cells.
    np.testing.assert_allclose(cells.medians(values), [g[(len(g) - 1) // 2] for g in groups], atol=1e-10)
    np.testing.assert_allclose(cells.sums(values), [g.sum() for g in groups], atol=1e-12)


def test_scale_withstands_outliers():
    rng = np.random.default_rng(17)
    values = np.concatenate([0.02 * rng.normal(size=8000), rng.uniform(-1, 1, 2000)])
    # 2000 outliers spread over a width of 2 leave about 100 within 2.5 sigma: a few per cent.
    assert robust_scale(values, 0.0) == pytest.approx(0.02, rel=0.06)
    assert robust_scale(np.zeros(10), 1e-10) == 1e-10


@pytest.mark.parametrize("power", [1.0, 2.0, 3.0])
def test_the_likely_penalty_is_that_of_the_model(power):
    rng = np.random.default_rng(18)
    b, noise = 48, 1e-3
    penalty = (bending(b) / (20 * 21) ** 2) ** (power / 2)
    spread = np.sqrt(np.divide(noise**2, penalty, out=np.ones_like(penalty), where=penalty > 0))
    coefficients = rng.normal(size=b * b) * np.sqrt(spread**2 + noise**2)
    _, found = likely_penalty(coefficients, b, noise**2)
    # Sharpest at the degree where signal and noise are equal; 41 coefficients a degree leave some ten per cent.
    place = int(np.abs(penalty - 1).argmin())
    assert found[place] == pytest.approx(penalty[place], rel=0.3)


@pytest.mark.parametrize("normals", [None, "true", "garbage"])
def test_the_center_is_that_of_the_body_whatever_the_density(normals):
    rng = np.random.default_rng(19)
    axes, offset = np.array([1.0, 1.4, 0.8]), np.array([5.0, -3.0, 2.0])
    points = ellipsoid(rng, axes, 20000)
    points = points[rng.random(len(points)) < np.where(points[:, 1] > 0.3, 1.0, 0.1)]
    made = {None: None, "true": points / axes**2, "garbage": rng.normal(size=points.shape)}
    points = points + 0.01 * rng.normal(size=points.shape)
    bad = rng.random(len(points)) < 0.1
    points[bad] = rng.uniform(-2, 2, (bad.sum(), 3))
    # Its centroid is the middle by symmetry; noise, outliers and the low degree leave a per cent.
    np.testing.assert_allclose(cloud_center(PointArrays(points + offset, made[normals])), offset, atol=0.02)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_center_of_tiny_and_huge_clouds(scale):
    points = random_directions(np.random.default_rng(20), 3000) + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(cloud_center(PointArrays(scale * points)) / scale, [1, 2, 3], atol=1e-3)


def test_the_center_of_a_body_that_lacks_a_side():
    rng = np.random.default_rng(21)
    points = random_directions(rng, 10000)
    # A quarter of the sphere is missing; the smooth filling is not quite a sphere.
    np.testing.assert_allclose(cloud_center(PointArrays(points[points[:, 2] < 0.5])), 0, atol=0.05)


def test_a_longitude_just_below_a_full_turn_has_a_cell() -> None:
    """Found by the damaged files: the HEALPix look-up fails on a longitude that rounds to 2π."""
    cells = AngularCells.of(np.array([[0.404341081, -5.04217181e-18, -0.914608271], [0.0, 0.0, 1.0]]), 192)
    assert cells.count.sum() == 2
