"""The sample files: they are what the script writes, and they are what their README says they are."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

SAMPLES = Path(__file__).parents[1] / "samples"
OURS = {".py", ".md", ".pyc"}  # what lies in the folder and is not generated

STAR_SHAPED = [
    "bennu_like.ply",
    "bennu_like_low.ply",
    "bumpy_ellipsoid.obj",
    "cushion_quads.obj",
    "gem.stl",
    "gem_rotated.stl",
    "spiky_star.glb",
    "stone_degree8.ply",
]
NOT_STAR_SHAPED = ["hand.ply", "horn.off", "starfish.ply", "starfish_posed.ply", "trefoil_knot.ply", "double_torus.off"]
GENUS = dict.fromkeys([*STAR_SHAPED, *NOT_STAR_SHAPED], 0) | {"trefoil_knot.ply": 1, "double_torus.off": 2}
OPEN = ["bowl.off", "vase_quads.obj"]


def generated_files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in OURS
    }


def read_mesh(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles as trimesh reads them; the corners of STL, which has no indices, are welded."""
    mesh = trimesh.load_mesh(SAMPLES / name, process=False)
    points, triangles = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    if name.endswith(".stl"):
        points, index = np.unique(points, axis=0, return_inverse=True)
        triangles = index.ravel()[triangles]
    return points, triangles


def directed_edges(triangles: np.ndarray) -> np.ndarray:
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)


def face_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals of twice the triangles' area."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def component_count(edges: np.ndarray, count: int) -> int:
    """Connected parts of a graph, by handing the smallest label on until nothing changes."""
    labels = np.arange(count)
    while True:
        before = labels.copy()
        np.minimum.at(labels, edges[:, 0], labels[edges[:, 1]])
        np.minimum.at(labels, edges[:, 1], labels[edges[:, 0]])
        labels = labels[labels]
        if np.array_equal(before, labels):
            return len(np.unique(labels))


def nearest_radius(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Distance from the origin of the one of `vertices` whose direction is closest to that of each point."""
    radius = np.linalg.norm(vertices, axis=1)
    return radius[np.argmax(points @ (vertices / radius[:, None]).T, axis=1)]


def kernel_depth(points: np.ndarray, triangles: np.ndarray) -> float:
    """Radius of the largest ball inside every face plane: positive if and only if some point sees the whole surface.

    A negative value is a proof of the contrary: even the best point is behind some face by that much.
    """
    normals = face_normals(points, triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, points[triangles[:, 0]])
    constraints = np.hstack([normals, np.ones((len(normals), 1))])
    solution = linprog([0.0, 0.0, 0.0, -1.0], A_ub=constraints, b_ub=offsets, bounds=(None, None), method="highs")
    assert solution.success
    return float(solution.x[3])


def test_the_script_writes_the_committed_files_byte_for_byte(tmp_path: Path) -> None:
    script = SAMPLES / "generate.py"
    subprocess.run([sys.executable, "-B", str(script), "--output", str(tmp_path)], check=True)
    expected, actual = generated_files(SAMPLES), generated_files(tmp_path)
    if importlib.util.find_spec("lazrs") is None:  # that packs it
        expected.pop("formats/ball.laz")
    assert sorted(actual) == sorted(expected)
    assert [name for name in actual if actual[name] != expected[name]] == []


def test_the_files_are_small() -> None:
    files = generated_files(SAMPLES)
    assert sum(map(len, files.values())) < 2_000_000
    assert max(len(data) for name, data in files.items() if name.startswith("broken/")) < 5_000


def test_the_readme_names_every_file() -> None:
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    assert [name for name in generated_files(SAMPLES) if f"`{name}`" not in text] == []


def test_every_mesh_is_checked_here() -> None:
    clouds = {"bennu_cloud.ply", "stone_cloud.xyzn", "trefoil_cloud.xyzrgb", "coloured_ball.pcd"}
    whole = {name for name in generated_files(SAMPLES) if "/" not in name}
    assert whole == {*GENUS, *OPEN, *clouds}


@pytest.mark.parametrize("name", sorted([*GENUS, *OPEN]))
def test_meshes_are_clean_manifolds(name: str) -> None:
    points, triangles = read_mesh(name)
    edges = directed_edges(triangles)
    assert len(np.unique(edges, axis=0)) == len(edges)  # no edge twice in one direction: manifold and oriented
    assert np.array_equal(np.unique(triangles), np.arange(len(points)))  # no vertex without a triangle
    assert len(np.unique(points, axis=0)) == len(points)  # welded
    assert component_count(edges, len(points)) == 1

    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).reshape(-1, 3)
    heights = np.linalg.norm(face_normals(points, triangles), axis=1) / lengths.max(axis=1)
    # The flattest triangles, at the horn's tip and in the vase's bottom, are 0.006 high; rounding is by 1e-5.
    assert heights.min() > 1e-3


@pytest.mark.parametrize("name", sorted([*GENUS, *OPEN]))
def test_the_triangles_around_a_vertex_form_one_fan(name: str) -> None:
    """Of v, the edges opposite to it link its neighbours into one path or ring: no two sheets touch in a vertex."""
    _, triangles = read_mesh(name)
    around = np.concatenate([np.roll(triangles, -k, axis=1) for k in range(3)])  # vertex, and the edge opposite to it
    # Nodes are pairs (vertex, neighbour); a vertex is in as many parts of this graph as it has fans.
    size = triangles.max() + 1
    pairs = np.stack([around[:, 0] * size + around[:, 1], around[:, 0] * size + around[:, 2]], axis=1)
    nodes, index = np.unique(pairs, return_inverse=True)
    assert component_count(index.reshape(-1, 2), len(nodes)) == size


@pytest.mark.parametrize(("name", "genus"), sorted(GENUS.items()))
def test_closed_meshes_have_the_genus_the_readme_tells(name: str, genus: int) -> None:
    points, triangles = read_mesh(name)
    edges = directed_edges(triangles)
    assert set(map(tuple, edges)) == set(map(tuple, edges[:, ::-1]))  # every edge has its opposite: closed
    assert len(points) - len(edges) // 2 + len(triangles) == 2 - 2 * genus
    volume = np.einsum("ij,ij->", face_normals(points, triangles), points[triangles[:, 0]]) / 6.0
    assert volume > 0.1  # normals point outwards; the smallest body, the hand, has 0.2


@pytest.mark.parametrize("name", OPEN)
def test_open_meshes_are_discs(name: str) -> None:
    points, triangles = read_mesh(name)
    edges = {tuple(edge) for edge in directed_edges(triangles).tolist()}
    boundary = {start: end for start, end in edges if (end, start) not in edges}
    assert len(points) - (len(edges) + len(boundary)) // 2 + len(triangles) == 1
    heights = points[list(boundary), 2]
    assert np.ptp(heights) == 0.0 and heights[0] == points[:, 2].max()  # one rim, at the top


@pytest.mark.parametrize("name", STAR_SHAPED)
def test_some_point_sees_all_of_a_star_shaped_sample(name: str) -> None:
    assert kernel_depth(*read_mesh(name)) > 0.01  # far above the rounding of 1e-5


@pytest.mark.parametrize("name", NOT_STAR_SHAPED)
def test_no_point_sees_all_of_the_others(name: str) -> None:
    assert kernel_depth(*read_mesh(name)) < -0.01


def test_the_gem_is_convex() -> None:
    points, triangles = read_mesh("gem.stl")
    normals = face_normals(points, triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    above = points @ normals.T - np.einsum("ij,ij->i", normals, points[triangles[:, 0]])
    assert above.max() < 1e-4  # rounding by 1e-5, times the slope over the flat table


def test_quads_stay_quads() -> None:
    faces = [line.split()[1:] for line in (SAMPLES / "cushion_quads.obj").read_text().splitlines() if line[0] == "f"]
    assert {len(face) for face in faces} == {4}


def readme_stone(directions: np.ndarray) -> np.ndarray:
    """The formula of the README, one harmonic after the other."""
    colatitude, longitude = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    radius = np.zeros(len(directions))
    for degree in range(9):
        for order in range(-degree, degree + 1):
            index = degree * degree + degree + order
            scale = np.sqrt(4.0 * np.pi) if index == 0 else 0.9 * np.cos(1.0 + 2.4 * index) / (degree + 1.0) ** 2
            complex_harmonic = (-1.0) ** order * sph_harm_y(degree, abs(order), colatitude, longitude)
            real = complex_harmonic.imag if order < 0 else complex_harmonic.real
            radius += scale * real * (1.0 if order == 0 else np.sqrt(2.0))
    return radius


def test_the_stone_is_the_sum_of_harmonics_the_readme_gives() -> None:
    points, _ = read_mesh("stone_degree8.ply")
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - readme_stone(points / radius[:, None])).max() < 3e-7  # seven decimals in the file


def test_the_stone_cloud_lies_on_the_stone_and_is_uneven() -> None:
    points, normals = np.split(np.loadtxt(SAMPLES / "stone_cloud.xyzn"), 2, axis=1)
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - readme_stone(points / radius[:, None])).max() < 5e-5  # five decimals in the file
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 2e-3  # three decimals
    assert np.einsum("ij,ij->i", normals, points).min() > 0.0  # outwards
    assert np.mean(points[:, 0] > 0.0) > 0.75


def test_the_normals_of_the_stone_cloud_are_those_of_the_mesh() -> None:
    """Independent of the script's derivative: the nearest triangle of the mesh has nearly the same normal."""
    points, normals = np.split(np.loadtxt(SAMPLES / "stone_cloud.xyzn"), 2, axis=1)
    vertices, triangles = read_mesh("stone_degree8.ply")
    centres, across = vertices[triangles].mean(axis=1), face_normals(vertices, triangles)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    nearest = np.argmin(-2.0 * points @ centres.T + np.sum(centres**2, axis=1), axis=1)
    agreement = np.einsum("ij,ij->i", normals, across[nearest])
    assert agreement.min() > 0.97  # triangles of size 0.09 turn by up to 0.13 (cosine 0.992)


def test_the_low_body_is_the_turned_body() -> None:
    """Radii along the same directions agree up to what the coarse mesh cannot show."""
    turn = Rotation.from_rotvec(np.radians(50.0) * np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0))
    back = turn.inv().apply(read_mesh("bennu_like_low.ply")[0])
    full, _ = read_mesh("bennu_like.ply")
    error = np.linalg.norm(back, axis=1) - nearest_radius(back, full)
    # The nearest vertex is up to 0.03 away, and boulders are steep: 0.006. Without turning back it would be 0.06.
    assert np.sqrt(np.mean(error**2)) < 0.015


def test_the_rotated_gem_is_the_gem_turned_scaled_and_moved() -> None:
    turn = Rotation.from_rotvec(np.radians(75.0) * np.array([2.0, -1.0, 1.0]) / np.sqrt(6.0))
    corners, moved = (
        np.array(trimesh.load_mesh(SAMPLES / name, process=False).triangles) for name in ("gem.stl", "gem_rotated.stl")
    )
    expected = 1.3 * turn.apply(corners.reshape(-1, 3)) + [2.0, -1.0, 0.5]
    assert np.abs(moved.reshape(-1, 3) - expected).max() < 2e-5  # both files are rounded to 1e-5


def test_the_cloud_has_noise_outliers_and_a_hole() -> None:
    cloud = np.asarray(trimesh.load(SAMPLES / "bennu_cloud.ply").vertices)
    full, _ = read_mesh("bennu_like.ply")
    assert len(cloud) == 6000
    directions = cloud / np.linalg.norm(cloud, axis=1, keepdims=True)
    hole = np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])
    share = np.mean(directions @ hole > np.cos(np.radians(24.0)))
    assert share < 0.01  # outliers only; the whole body would have 4 %
    error = np.linalg.norm(cloud, axis=1) - nearest_radius(cloud, full)
    assert 0.03 < np.mean(np.abs(error) > 0.12) < 0.05  # 5 % are outliers, of which a few lie near the surface
    assert 0.004 < np.median(np.abs(error)) < 0.012  # noise of 0.005, and the step to the nearest vertex


def test_colours_are_colours() -> None:
    points, colors = np.split(np.loadtxt(SAMPLES / "trefoil_cloud.xyzrgb"), 2, axis=1)
    assert len(points) == 1500 and colors.min() >= 0.0 and colors.max() <= 1.0 and np.ptp(colors, axis=0).min() > 0.9
    rows = np.loadtxt(SAMPLES / "coloured_ball.pcd", skiprows=11)
    packed = rows[:, 3].astype(np.int64)
    channels = np.stack([packed >> 16, packed >> 8 & 255, packed & 255])
    assert np.abs(np.linalg.norm(rows[:, :3], axis=1) - 1.0).max() < 2e-5  # five decimals
    assert channels.min() >= 0 and channels.max() <= 255 and np.ptp(channels, axis=1).min() > 230
