"""ShellShape: encode, decode to any topology, level of detail, files; both kinds of Open3D geometry."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryError, GeometryReadError, MemoryEstimateError
from fsh3d_o3d.geometry import MeshArrays, PointArrays, open3d_mesh
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.geometry.surface_comparison import surface_error
from fsh3d_o3d.shapes import storage
from fsh3d_o3d.shapes.ball import BallFunction
from fsh3d_o3d.shapes.shell import ShellShape
from fsh3d_o3d.shells.iso_surface import zero_surface
from tests.geometry.mesh_shapes import box, frame, sphere, torus


def check_closed(mesh, genus):
    measures = measure_mesh(mesh)
    assert measures.closed
    assert measures.vertex_manifold
    assert measures.outward
    assert measures.degenerate_triangles == 0
    assert measures.genus == genus


@pytest.fixture(scope="module")
def ring():
    return ShellShape.from_geometry(torus(), 16, 32, "signed_distance")


def ball_coefficients(function, bandwidth, radii):
    """Harmonics on shells of a function of points (…, 3)."""
    transform = fsh.SphericalHarmonicTransform(bandwidth)
    return transform.forward(function(radii[:, None, None] * transform.grid.directions))


def smooth(points):
    """A polynomial and a Gaussian: all degrees, no symmetry, smooth at the centre."""
    x, y, z = np.moveaxis(points, -1, 0)
    return 0.3 + x - 2 * y * z + x**2 * y - z**3 + np.exp(-((x - 0.2) ** 2) - 2 * y**2 - (z + 0.1) ** 2)


def test_smooth_functions_are_regular_at_the_centre_and_between_shells(rng):
    errors = []
    for shells in (16, 32):
        radii = np.arange(1, shells + 1) / shells
        ball = BallFunction(ball_coefficients(smooth, 20, radii), radii[0])
        points = rng.uniform(-1, 1, (20_000, 3))
        points *= (0.9 * rng.random(20_000) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
        near = 0.3 / shells * rng.uniform(-1, 1, (2000, 3))  # within the innermost shell
        errors.append([np.abs(ball(p) - smooth(p)).max() for p in (points, near)])
    # Cubic splines: fourth order between the shells. In the innermost cell the odd degrees from 3 on begin with r.
    assert errors[1][0] < 2e-5
    assert errors[0][0] / errors[1][0] > 8
    assert errors[1][1] < 2e-5
    assert errors[0][1] / errors[1][1] > 4


def test_all_directions_agree_at_the_centre(rng):
    coefficients = rng.standard_normal((8, 25))  # not the spectrum of anything smooth
    ball = BallFunction(coefficients, 0.125)
    values = ball(1e-6 * fsh.fibonacci_grid(50).directions)
    assert np.ptp(values) < 1e-3  # slopes of order 10 / 0.125, and float32
    assert values.mean() == pytest.approx(ball(np.zeros((1, 3)))[0], abs=1e-3)


def test_shells_are_met_and_the_field_is_constant_beyond(rng):
    coefficients = rng.standard_normal((6, 16))
    ball = BallFunction(coefficients, 0.5)
    directions = fsh.fibonacci_grid(40).directions
    for shell in range(6):
        expected = fsh.evaluate(coefficients[shell], directions)
        assert ball(0.5 * (shell + 1) * directions) == pytest.approx(expected, abs=2e-5)  # float32
    assert ball(7.0 * directions) == pytest.approx(expected, abs=2e-5)


def test_sphere_has_degree_zero_only():
    shape = ShellShape.from_geometry(sphere(48, 2.0, (1.0, 2.0, 3.0)), 8, 16, "signed_distance", width=math.inf)
    assert shape.center == pytest.approx([1, 2, 3], abs=1e-9)
    assert shape.scale == pytest.approx(2, rel=1e-9)
    expected = np.sqrt(4 * np.pi) * (shape.radii - 1)
    # Facets of 0.02 lie up to 1e-4 inside of the sphere.
    assert shape.coefficients[:, 0] == pytest.approx(expected, abs=5e-4)
    assert np.abs(shape.coefficients[:, 1:]).max() < 5e-4


def test_no_staircase_between_shells():
    """The field of a sphere off the centre, along a ray: values between shells are as good as on them."""
    mesh = sphere(32, 1.0, (0.3, 0.2, -0.1))
    shape = ShellShape.from_geometry(mesh, 16, 32, "signed_distance", center=np.zeros(3), width=math.inf)
    way = np.array([0.48, 0.64, 0.6])
    steps = shape.radii[-1] * shape.scale * np.linspace(0.55, 0.98, 1000)
    points = steps[:, None] * way
    exact = (np.linalg.norm(points - [0.3, 0.2, -0.1], axis=1) - 1) / shape.scale
    error = shape.evaluate(points) - exact
    assert np.abs(error).max() < 5e-4  # facets 2e-4; the field is smooth out here
    # A staircase has slopes of 0 and of several between; the true slope is near 1.
    slope = np.diff(shape.evaluate(points)) / np.diff(exact)
    assert np.abs(slope - 1).max() < 0.05


@pytest.mark.parametrize(("mesh", "genus"), [(torus(), 1), (frame(), 1), (box((1.0, 1.4, 0.8)), 0)])
def test_topology_comes_back(mesh, genus):
    shape = ShellShape.from_geometry(mesh, 16, 32, "signed_distance")
    decoded, normals = shape.mesh_arrays(64)
    check_closed(decoded, genus)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-12)
    # Edges and corners are rounded at the size of half a wavelength, π/16 of the radius.
    assert surface_error(mesh, decoded, samples=5000).relative().rmse < 0.008


def test_torus_is_where_it_was(ring):
    decoded, normals = ring.mesh_arrays(64)
    x, y, z = decoded.vertices.T
    tube = np.hypot(np.hypot(x, y) - 2, z)
    assert np.sqrt(np.mean((tube - 0.5) ** 2)) < 0.01  # 0.2 % of the diagonal; facets of the input alone 0.004
    outward = np.column_stack(((1 - 2 / np.hypot(x, y)) * x, (1 - 2 / np.hypot(x, y)) * y, z)) / tube[:, None]
    # A normal is off by the relative ripple's slope; the tube is two wavelengths thick.
    assert np.einsum("ij,ij->i", outward, normals).min() > 0.97


def test_two_parts_and_specks():
    big, small = sphere(8), sphere(4, 0.3, (1.9, 0, 0))
    both = MeshArrays(
        np.concatenate((big.vertices, small.vertices)),
        np.concatenate((big.triangles, small.triangles + len(big.vertices))),
    )
    shape = ShellShape.from_geometry(both, 16, 32, "signed_distance")
    assert measure_mesh(shape.mesh_arrays(64)[0]).components == 2
    alone, normals = shape.mesh_arrays(64, smallest=0.1)
    assert len(normals) == len(alone.vertices)
    check_closed(alone, 0)
    assert alone.vertices[:, 0].max() < 1.3


@pytest.mark.parametrize("field", ["occupancy", "gaussian_distance"])
def test_other_fields_decode_too(field):
    shape = ShellShape.from_geometry(sphere(12), 8, 32, field)
    decoded = shape.mesh_arrays(64)[0]
    radius = np.linalg.norm(decoded.vertices, axis=1)
    measures = measure_mesh(decoded)
    assert measures.closed
    assert measures.outward
    if field == "occupancy":
        assert np.abs(radius - 1).max() < 0.02  # facets 0.005, and a transition over one shell
    else:  # a shell as thick as twice the width
        assert measures.components == 2
        assert np.abs(np.abs(radius - 1) - shape.width).max() < 0.02


def test_volume_is_the_field_on_its_grid(ring):
    volume = ring.to_volume(20)
    assert volume.values.shape == (20, 20, 20)
    index = np.array([[0, 0, 0], [3, 7, 11], [10, 9, 8], [19, 19, 0]])
    points = volume.origin + volume.spacing * index
    assert volume.values[tuple(index.T)] == pytest.approx(ring.evaluate(points), abs=1e-6)
    assert volume.origin + 19 * volume.spacing == pytest.approx(2 * ring.center - volume.origin)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_scale_and_shift_only_change_the_frame(ring, size):
    mesh = torus()
    moved = MeshArrays((mesh.vertices + np.array([4.0, 5.0, 6.0])) * size, mesh.triangles)
    shape = ShellShape.from_geometry(moved, 16, 32, "signed_distance")
    assert shape.scale == pytest.approx(ring.scale * size, rel=1e-12)
    # float32 decides between equally near triangles: 1e-7 of the size, times √4π.
    assert shape.coefficients == pytest.approx(ring.coefficients, abs=1e-5)
    decoded = shape.mesh_arrays(64)[0]
    assert measure_mesh(decoded).genus == 1
    assert decoded.vertices / size - [4, 5, 6] == pytest.approx(ring.mesh_arrays(64)[0].vertices, abs=1e-3)


def test_energies_do_not_change_under_rotation(ring, random_rotation):
    mesh = torus()
    turned = ShellShape.from_geometry(
        MeshArrays(mesh.vertices @ random_rotation.T + 1.0, mesh.triangles), 16, 32, "signed_distance"
    )
    before, after = ring.compute_feature().data, turned.compute_feature().data
    assert before.shape == (16 * 32, 1)
    # The field has kinks; what aliases from degrees beyond 2b depends on how the grid lies.
    assert np.linalg.norm(after - before) < 3e-3 * np.linalg.norm(before)


def test_feature_is_the_energy_per_degree_and_shell(ring):
    data = ring.compute_feature().data.reshape(16, 32)
    assert data[:, 5] == pytest.approx(fsh.degree_energies(ring.coefficients[5]))
    assert (data**2).sum() == pytest.approx((ring.coefficients**2).sum())


def test_truncation_and_filter(ring):
    coarse = ring.truncated(6)
    assert coarse.bandwidth == 6
    assert np.array_equal(coarse.coefficients, ring.coefficients[:, :36])
    assert np.array_equal(coarse.radii, ring.radii)
    kept = ring.filtered(fsh.ideal_filter(16, 6))
    assert np.array_equal(kept.coefficients[:, :36], coarse.coefficients)
    assert not kept.coefficients[:, 36:].any()


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_kind_of_geometry_is_kept(kind):
    module = o3d.geometry if kind == "legacy" else o3d.t.geometry
    shape = ShellShape.from_geometry(open3d_mesh(sphere(6), kind), 4, 8, "signed_distance")
    assert shape.kind == kind
    assert isinstance(shape.to_triangle_mesh(24), module.TriangleMesh)
    assert isinstance(shape.to_point_cloud(50), module.PointCloud)
    other = "tensor" if kind == "legacy" else "legacy"
    assert isinstance(shape.to_triangle_mesh(24, kind=other), type(open3d_mesh(sphere(2), other)))


def test_point_cloud_lies_on_the_surface(ring):
    cloud = ring.to_point_cloud(500)
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    assert points.shape == (500, 3)
    assert np.abs(ring.evaluate(points)).max() < 0.01  # the mesh's facets, in units of the radius
    step = ring.evaluate(points + 0.01 * normals) - ring.evaluate(points - 0.01 * normals)
    assert (step > 0).all()


def test_cloud_with_normals_becomes_a_solid():
    directions = fsh.fibonacci_grid(2000).directions
    shape = ShellShape.from_geometry(PointArrays(2 * directions, directions), 8, 16, "signed_distance")
    decoded = shape.mesh_arrays(48)[0]
    check_closed(decoded, 0)
    assert np.linalg.norm(decoded.vertices, axis=1) == pytest.approx(2, abs=0.03)  # a cell of the Poisson grid


@pytest.mark.parametrize("field", ["signed_distance", "occupancy", "gaussian_distance"])
def test_files(tmp_path, field):
    width = math.inf if field == "signed_distance" else None
    mesh = open3d_mesh(sphere(6, 1.5, (1, 0, 2)), "tensor")
    shape = ShellShape.from_geometry(mesh, 5, 7, field, width=width)
    path = tmp_path / "shape.npz"
    shape.save(path)
    again = fsh.load_shape(path)
    assert isinstance(again, ShellShape)
    for name in ("coefficients", "radii", "center"):
        assert getattr(again, name).tobytes() == getattr(shape, name).tobytes()
    for name in ("field", "scale", "width", "kind"):
        assert getattr(again, name) == getattr(shape, name)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coefficients", np.zeros((7, 24))),
        ("coefficients", np.zeros((2, 25))),
        ("radii", np.ones(7)),
        ("radii", np.arange(1.0, 9.0)),
        ("center", np.zeros(2)),
        ("scale", np.array(-1.0)),
        ("scale", np.ones(2)),
        ("width", np.array(np.nan)),
        ("width", None),
        ("field", np.array("colour")),
        ("geometry", np.array("wood")),
    ],
)
def test_damaged_files(tmp_path, name, value):
    path = tmp_path / "shape.npz"
    ShellShape.from_geometry(sphere(4), 5, 7).save(path)
    arrays = storage.read_arrays(path)[1]
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    storage.write_arrays(path, "ShellShape", arrays)
    with pytest.raises(GeometryReadError, match=r"shape\.npz"):
        fsh.load_shape(path)


def test_values_are_read_only(ring):
    for array in (ring.coefficients, ring.radii, ring.center, ring.to_volume(8).values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        ring.scale = 2.0


def test_same_input_same_bytes(ring):
    again = ShellShape.from_geometry(torus(), 16, 32, "signed_distance", threads=1)
    assert again.coefficients.tobytes() == ring.coefficients.tobytes()
    one, two = (shape.mesh_arrays(40, threads=n)[0].vertices for shape, n in ((ring, 2), (again, 1)))
    assert one.tobytes() == two.tobytes()


def test_a_field_without_inside_is_refused(ring):
    with pytest.raises(GeometryError, match="no inside"):
        ring.mesh_arrays(32, level=-0.9)
    with pytest.raises(GeometryError, match="no inside"):
        ring.filtered(lambda degree: np.zeros(len(degree))).mesh_arrays(32)


@pytest.mark.parametrize("seed", range(4))
def test_iso_surfaces_of_noise_are_closed_and_manifold(seed):
    """The hardest topology there is: every cell ambiguous, values exactly zero among them."""
    noise = np.random.default_rng(seed).integers(-2, 3, (9, 9, 9)).astype(float)
    mesh = zero_surface(noise)[0]
    measures = measure_mesh(mesh)
    assert measures.closed
    assert measures.vertex_manifold
    assert measures.consistently_oriented
    assert measures.volume > 0


def test_a_field_that_reaches_the_end_of_the_grid_is_closed_there():
    mesh = zero_surface(np.full((5, 5, 5), -1.0))[0]
    check_closed(mesh, 0)
    with pytest.raises(GeometryError, match="finite"):
        zero_surface(np.full((4, 4, 4), np.nan))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"bandwidth": 0}, ValueError),
        ({"bandwidth": 2.0}, TypeError),
        ({"shells": 3}, ValueError),
        ({"shells": True}, TypeError),
        ({"field": "sdf"}, ValueError),
        ({"bandwidth": 4000, "shells": 4000}, MemoryEstimateError),
        ({"oversampling": 0.5}, ValueError),
        ({"width": -1.0}, ValueError),
        ({"center": "middle"}, TypeError),
        ({"threads": 0}, ValueError),
    ],
)
def test_bad_options(options, error):
    with pytest.raises(error):
        ShellShape.from_geometry(sphere(2), **options)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"points_per_side": 4}, ValueError),
        ({"points_per_side": 40.0}, TypeError),
        ({"points_per_side": 4000}, MemoryEstimateError),
        ({"level": math.nan}, ValueError),
        ({"smallest": 2.0}, ValueError),
        ({"kind": "plastic"}, ValueError),
    ],
)
def test_bad_decoding_options(ring, options, error):
    with pytest.raises(error):
        ring.to_triangle_mesh(**{"points_per_side": 16, **options})


def test_not_geometry_is_refused():
    with pytest.raises(TypeError, match="geometry"):
        ShellShape.from_geometry(object(), 4, 8)
