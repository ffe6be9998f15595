import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.report.thumbnail import encode_png, render_thumbnail, side_by_side
from tests.report.shapes import ball, ball_points, square

SIZE = 96
TOP = (0, 0, 1)


def render(geometry, **options):
    return render_thumbnail(geometry, **{"width": SIZE, "height": SIZE, **options})


def silhouette(image):
    """Coverage (h, w) in [0, 1] of a picture without background."""
    return image[..., 3] / 255


def test_ball_is_a_disc_of_the_right_area():
    coverage = silhouette(render(ball(48), background=None))
    radius = SIZE / 2 / 1.04  # the margin around the bounding sphere
    # A polyhedron of 48 rings is smaller by 1e-3; four samples a pixel at the rim average to some 1e-3 as well.
    assert coverage.sum() == pytest.approx(np.pi * radius**2, rel=5e-3)
    np.testing.assert_allclose(coverage, coverage[::-1], atol=0.26)  # one of four samples may fall either way


def test_square_covers_the_pixels_that_geometry_says():
    coverage = silhouette(render(square(), direction=TOP, background=None))
    half = SIZE / 2 / 1.04 / np.sqrt(2)
    inside = np.abs(np.arange(SIZE) + 0.5 - SIZE / 2) < half - 1
    outside = np.abs(np.arange(SIZE) + 0.5 - SIZE / 2) > half + 1
    assert (coverage[np.ix_(inside, inside)] == 1).all()
    assert (coverage[outside] == 0).all()
    assert (coverage[:, outside] == 0).all()


def test_directions_and_handedness():
    # From above: x to the right, y up. The triangle fills the lower left half of a square.
    triangle = MeshArrays(square().vertices, [[0, 1, 3]])
    coverage = silhouette(render(triangle, around=square(), direction=TOP, background=None))
    quarter = SIZE // 4 + 6
    assert coverage[-quarter, quarter] == 1
    assert coverage[quarter, -quarter] == 0
    corner = silhouette(render(PointArrays([[-0.5, -0.5, 0]]), around=square(), direction=TOP, background=None))
    assert corner[SIZE // 2 :, : SIZE // 2].sum() == corner.sum() > 0
    # From +x: y to the right, z up.
    upright = MeshArrays([[0, -1, -1], [0, 1, -1], [0, 1, 1]], [[0, 1, 2]])
    coverage = silhouette(render(upright, direction=(7, 0, 0), background=None))
    assert coverage[-quarter, -quarter] == 1
    assert coverage[quarter, quarter] == 0


def test_nearer_surface_hides_the_farther():
    near = square().vertices * 0.5 + (0, 0, 0.3)
    mesh = MeshArrays(np.concatenate((square().vertices, near)), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    colors = np.repeat([[1.0, 0, 0], [0, 1.0, 0]], 4, axis=0)
    image = render(mesh, colors=colors, direction=TOP)
    assert image[SIZE // 2, SIZE // 2, 1] > 100 > image[SIZE // 2, SIZE // 2, 0]
    image = render(mesh, colors=colors, direction=(0, 0, -1))
    assert image[SIZE // 2, SIZE // 2, 0] > 100 > image[SIZE // 2, SIZE // 2, 1]


def test_nearer_points_hide_the_farther():
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 60)] * 2), -1).reshape(-1, 2)
    red, green = (np.column_stack((grid, np.full(len(grid), z))) for z in (-0.2, 0.2))
    colors = np.repeat([[1.0, 0, 0], [0, 1.0, 0]], len(grid), axis=0)
    cloud = PointArrays(np.concatenate((red, green)), np.tile([0.0, 0, 1], (2 * len(grid), 1)), colors)
    middle = (slice(SIZE // 2 - 4, SIZE // 2 + 4),) * 2
    above, below = (render(cloud, direction=(0, 0, z))[middle].astype(int) for z in (1, -1))
    assert (above[..., 1] > above[..., 0]).all()
    assert (below[..., 0] > below[..., 1]).all()


def test_dense_cloud_looks_like_the_surface():
    cloud = render(ball_points(30_000, normals=ball_points(30_000).points), background=None)
    mesh = render(ball(48), background=None)
    # The splats stand out by a pixel or two around a circumference of 290 pixels, of 6,700 pixels in all.
    assert np.abs(silhouette(cloud) - silhouette(mesh)).sum() < 600
    core = (slice(SIZE // 3, 2 * SIZE // 3),) * 2
    # The cloud has no occlusion but a depth cue instead; the light is the same.
    assert np.abs(cloud[core].astype(int) - mesh[core])[..., :3].mean() < 25


def test_estimated_normals_shade_like_given_ones():
    points = ball_points(20_000)
    given_normals = render(PointArrays(points.points, points.points)).astype(int)
    estimated = render(points).astype(int)
    # Neighbours 0.03 apart on the unit sphere tell its normal to a degree or two.
    assert np.abs(given_normals - estimated).mean() < 4


def test_light_comes_from_above_left():
    image = render(ball(48), direction=(0, -1, 0), occlusion=False).astype(int)
    lit, dark = image[SIZE // 4, SIZE // 4], image[3 * SIZE // 4, 3 * SIZE // 4]
    assert (lit > dark + 40).all()


def test_hollows_are_darker_with_occlusion():
    floor, box = square(3), square(1)
    walls = MeshArrays(
        np.concatenate((floor.vertices, box.vertices, box.vertices + np.array([0, 0, 2]))),
        [[0, 1, 2], [0, 2, 3]]
        + [[4 + i, 4 + (i + 1) % 4, 8 + i] for i in range(4)]
        + [[4 + (i + 1) % 4, 8 + (i + 1) % 4, 8 + i] for i in range(4)],
    )
    bare, hollow = (render(walls, direction=TOP, occlusion=flag).astype(int) for flag in (False, True))
    centre, away = (SIZE // 2, SIZE // 2), (SIZE // 2, SIZE // 2 + 26)
    assert (bare[centre] > hollow[centre] + 15).all()
    assert np.abs(bare[away] - hollow[away]).max() < 12  # two units from the walls, near the reach of the rays


def test_normals_smooth_the_facets():
    mesh = ball(8)
    flat = render(mesh, occlusion=False)
    smooth = render(mesh, normals=mesh.vertices, occlusion=False)
    reference = render(ball(64), occlusion=False)
    middle = (slice(SIZE // 4, 3 * SIZE // 4),) * 2
    error = [np.abs(image[middle].astype(int) - reference[middle]).mean() for image in (flat, smooth)]
    assert error[1] < error[0] / 3


def test_inverted_mesh_and_normals_look_the_same():
    mesh = ball(16)
    inverted = MeshArrays(mesh.vertices, mesh.triangles[:, ::-1])
    np.testing.assert_array_equal(render(mesh, normals=mesh.vertices), render(mesh, normals=-mesh.vertices))
    # The rays meet the same triangles with their corners in another order: rounding only.
    assert np.abs(render(mesh).astype(int) - render(inverted)).max() <= 2


def test_unusable_normals_fall_back_to_the_facets():
    mesh = ball(16)
    for bad in (0.0, np.nan):
        np.testing.assert_array_equal(render(mesh, normals=np.full(mesh.vertices.shape, bad)), render(mesh))


@pytest.mark.parametrize("shape", [ball(12), ball_points(2_000)])
@settings(max_examples=8, deadline=None)
@given(exponent=st.integers(-100, 100), turns=st.integers(-3, 3))
def test_size_and_place_do_not_matter(shape, exponent, turns):
    points = shape.vertices if isinstance(shape, MeshArrays) else shape.points
    moved = points * 2.0**exponent + turns * 2.0**exponent
    other = MeshArrays(moved, shape.triangles) if isinstance(shape, MeshArrays) else PointArrays(moved)
    # The shift rounds coordinates by some 1e-16; a sample at an edge, and a normal of unclear sign, may change.
    difference = np.abs(render(shape).astype(int) - render(other)).max(axis=2)
    assert (difference > 2).mean() < 0.01


@pytest.mark.parametrize("factor", [1e-30, 1e30, 1e300, 1e-300])
def test_extreme_coordinates(factor):
    coverage = silhouette(render(MeshArrays(ball(12).vertices * factor, ball(12).triangles), background=None))
    assert np.abs(coverage - silhouette(render(ball(12), background=None))).sum() < 10


def test_million_fold_offset():
    coverage = silhouette(render(ball(12, center=(1e6, -1e6, 1e6)), background=None))
    assert np.abs(coverage - silhouette(render(ball(12), background=None))).sum() < 10


def test_picture_is_reproducible_and_arguments_stay():
    cloud = ball_points(500)
    before = cloud.points.copy()
    assert encode_png(render(cloud)) == encode_png(render(cloud))
    assert encode_png(render(ball())) == encode_png(render(ball()))
    np.testing.assert_array_equal(cloud.points, before)


def test_open3d_geometry_brings_its_normals_and_colours():
    o3d = open3d()
    mesh = ball(12)
    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.copy()), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    np.testing.assert_array_equal(render(legacy), render(mesh))
    red = np.tile([1.0, 0, 0], (len(mesh.vertices), 1))
    legacy.vertex_normals = o3d.utility.Vector3dVector(mesh.vertices.copy())
    legacy.vertex_colors = o3d.utility.Vector3dVector(red)
    expected = render(mesh, normals=mesh.vertices, colors=red)
    np.testing.assert_array_equal(render(legacy), expected)
    tensor = o3d.t.geometry.TriangleMesh.from_legacy(legacy)
    # Tensor meshes made from legacy ones hold float32.
    assert np.abs(render(tensor).astype(int) - expected).mean() < 0.5


def test_geometry_may_exceed_the_one_it_is_fitted_to():
    giant = MeshArrays(1e3 * ball(12).vertices, ball(12).triangles)
    assert silhouette(render(giant, around=ball(12), background=None)).min() == 1
    near_and_far = PointArrays([[0.0, 0, 0], [0, 0, 1e9], [1e12, 0, 0]])
    coverage = silhouette(render(near_and_far, around=ball(12), direction=TOP, background=None))
    assert coverage[SIZE // 2, SIZE // 2] > 0
    assert (coverage > 0).sum() < 50


def test_width_height_and_background():
    image = render(ball(12), width=120, height=60, background=(0.2, 0.4, 1.0))
    assert image.shape == (60, 120, 3)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image[0, 0], [51, 102, 255])
    assert render(ball(12), background=None).shape == (SIZE, SIZE, 4)
    assert render(ball(12), width=1, height=1).shape == (1, 1, 3)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"width": 0}, ValueError),
        ({"height": 1e3}, TypeError),
        ({"width": 10**9}, ValueError),
        ({"direction": (0, 0, 0)}, ValueError),
        ({"direction": (0, np.nan, 0)}, ValueError),
        ({"colors": np.zeros((3, 3))}, ValueError),
        ({"colors": np.full((1106, 3), 2.0)}, ValueError),
        ({"normals": np.zeros(3)}, ValueError),
        ({"background": "white"}, TypeError),
        ({"background": (0, 0, 3)}, ValueError),
        ({"around": 1.0}, TypeError),
    ],
)
def test_bad_arguments_are_refused(options, error):
    assert len(ball().vertices) == 1106
    with pytest.raises(error):
        render(ball(), **options)


def test_geometry_without_extent_is_refused():
    with pytest.raises(GeometryError, match="extent"):
        render(PointArrays([[1.0, 2, 3]] * 5))
    with pytest.raises(TypeError):
        render(object())


def test_two_points_and_flat_triangles_are_drawn():
    assert silhouette(render(PointArrays([[0.0, 0, 0], [1.0, 1, 1]]), background=None)).sum() > 2
    line = MeshArrays([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]])
    assert silhouette(render(line, background=None)).max() <= 1


def test_png_holds_the_picture():
    image = render(ball(12), background=None)
    np.testing.assert_array_equal(np.array(Image.open(io.BytesIO(encode_png(image)))), image)
    with pytest.raises(TypeError):
        encode_png(image / 255)
    with pytest.raises(ValueError):
        encode_png(image[..., 0])


def test_side_by_side_holds_the_pictures_and_captions():
    solid = [np.full((90, 80, 3), value, dtype=np.uint8) for value in (10, 60)]
    clear = np.zeros((60, 70, 4), dtype=np.uint8)
    strip = side_by_side([*solid, clear], ["one", "two", "three"])
    assert strip.shape[1] > 80 + 80 + 70
    assert (strip[:90, :80] == 10).all()
    assert (strip[:90] == 60).all(axis=2).sum() == 90 * 80
    assert (strip[:90, -70:] == 255).all()
    for left in (slice(0, 80), slice(92, 172), slice(-70, None)):
        assert (strip[90:, left] < 128).any()


def test_long_captions_are_cut():
    image = np.zeros((50, 60, 3), dtype=np.uint8)
    long, short = (side_by_side([image, image], [text, ""])[50:] for text in ("a long caption " * 20, "a"))
    assert long.shape == short.shape
    assert (long[:, 60:] == 255).all()
    assert (long < 128).sum() > (short < 128).sum()


@pytest.mark.parametrize("labels", [[], ["one"], ["one", "two", "three"]])
def test_labels_must_match_images(labels):
    image = np.zeros((5, 6, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match="label"):
        side_by_side([image, image], labels)
    with pytest.raises(ValueError, match="label"):
        side_by_side([], [])
