"""Write the sample shapes: `python samples/generate.py [--output DIR]`. README.md says what each one is for.

The files are the same bytes on every run. Nothing here needs Open3D or the package itself;
lazrs packs one file, and without it that is left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from _bodies import (
    bennu_like,
    bumpy_ellipsoid,
    double_torus,
    gem,
    hand,
    horn,
    normal,
    radial_normals,
    scattered_directions,
    starfish,
    stone,
    trefoil_knot,
    uniform,
)
from _cad_writers import write_iges, write_step
from _scene_writers import write_3mf, write_dae, write_fbx, write_x3d, zip_bytes
from _surfaces import Mesh, cube_sphere, halves, icosphere, radial, revolved, rotation, unit
from _survey_writers import Scan, las_bytes, write_e57
from _volume_writers import gzip_bytes, nifti_bytes, npy_bytes, nrrd_bytes, tiff_bytes
from _vtk_writers import write_vtk, write_vtp, write_vtu
from _writers import (
    Array,
    write_ascii_ply,
    write_glb,
    write_obj,
    write_off,
    write_pcd,
    write_ply,
    write_stl,
    write_xyz,
)

LOW_ROTATION = rotation((1.0, 2.0, 3.0), 50.0)
"""What turns bennu_like.ply into bennu_like_low.ply."""
GEM_ROTATION = rotation((2.0, -1.0, 1.0), 75.0)
"""What turns gem.stl into gem_rotated.stl, which is then moved and made larger."""
HOLE_AXIS = unit(np.array([0.6, 0.5, 0.62]))
"""Where bennu_cloud.ply has its hole."""


def write_star_shaped(folder: Path) -> None:
    """Closed surfaces every point of which the origin can see."""
    write_ply(folder / "bennu_like.ply", *radial(icosphere(22), bennu_like))
    points, quads = cube_sphere(17)
    coarse = radial(Mesh(points, halves(quads)), bennu_like)
    write_ply(folder / "bennu_like_low.ply", coarse.points @ LOW_ROTATION.T, coarse.triangles)

    ellipsoid = radial(icosphere(15), bumpy_ellipsoid)
    write_obj(folder / "bumpy_ellipsoid.obj", ellipsoid.points, [ellipsoid.triangles])
    write_ascii_ply(folder / "stone_degree8.ply", *radial(icosphere(13), stone), decimals=7)

    brilliant = gem()
    write_stl(folder / "gem.stl", *brilliant)
    write_stl(
        folder / "gem_rotated.stl", 1.3 * brilliant.points @ GEM_ROTATION.T + [2.0, -1.0, 0.5], brilliant.triangles
    )

    points, quads = cube_sphere(20)
    cushion = points / (np.abs(points) ** 5).sum(axis=1, keepdims=True) ** 0.2  # the unit ball of the 5-norm
    write_obj(folder / "cushion_quads.obj", cushion * [1.0, 0.8, 0.5], [quads])

    ball = icosphere(1)
    a, b, c = (ball.triangles[:, k] for k in range(3))
    tip = 12 + np.arange(20)  # one over every face of the icosahedron
    spikes = 2.0 * unit(ball.points[ball.triangles].mean(axis=1))
    sides = [np.stack(pair, axis=1) for pair in ((a, b, tip), (b, c, tip), (c, a, tip))]
    write_glb(folder / "spiky_star.glb", np.vstack([ball.points, spikes]), np.concatenate(sides))


def write_not_star_shaped(folder: Path) -> None:
    """Closed surfaces that no point sees whole: genus 0, then genus 1 and 2."""
    write_off(folder / "horn.off", *horn())
    write_ply(folder / "starfish.ply", *starfish((0.8, 0.8, 0.8, 0.8, 0.8)))
    write_ply(folder / "starfish_posed.ply", *starfish((-0.7, 0.9, 0.3, -1.0, 0.6)))
    write_ply(folder / "hand.ply", *hand())
    write_ply(folder / "trefoil_knot.ply", *trefoil_knot())
    write_off(folder / "double_torus.off", *double_torus())


def write_open(folder: Path) -> None:
    """Surfaces with one boundary loop."""
    height = np.linspace(0.0, 1.0, 14)[1:]
    rim, quads = revolved(np.stack([height, 0.6 * height**2], axis=1), 40)
    k = np.arange(40)
    bottom = np.stack([np.full(40, len(rim)), np.roll(k, -1), k], axis=1)
    write_off(folder / "bowl.off", np.vstack([rim, np.zeros((1, 3))]), np.concatenate([bottom, halves(quads)]))

    share = np.linspace(0.0, 1.0, 33)
    profile = np.stack([0.38 + 0.16 * np.sin(5.0 * share + 0.3) - 0.06 * share, 1.5 * share], axis=1)
    points, quads = revolved(profile, 36)
    write_obj(folder / "vase_quads.obj", points, [quads, np.arange(36)[None, ::-1]])


def write_clouds(folder: Path) -> None:
    """Points without triangles: noise, outliers, a hole, uneven density, normals, colours."""
    directions = scattered_directions(31, 7000)
    directions = directions[directions @ HOLE_AXIS < np.cos(np.radians(25.0))][:6000]
    noisy = directions * bennu_like(directions)[:, None] + 0.005 * normal(32, 6000, 3)
    outliers = scattered_directions(33, 300) * 1.6 * np.cbrt(uniform(34, 300, 1))  # uniform in a ball of radius 1.6
    order = np.argsort(uniform(35, 6000), kind="stable")  # outliers among the points, not at the end
    write_ply(folder / "bennu_cloud.ply", np.concatenate([noisy[:5700], outliers])[order])

    directions = scattered_directions(36, 6000)
    directions = directions[uniform(37, 6000) < 0.05 + 0.95 * ((1.0 + directions[:, 0]) / 2.0) ** 2][:2000]
    write_xyz(folder / "stone_cloud.xyzn", directions * stone(directions)[:, None], radial_normals(directions, stone))

    knot = _surface_points(trefoil_knot(), 38, 1500)
    around = np.arctan2(knot[:, 1], knot[:, 0])
    write_xyz(folder / "trefoil_cloud.xyzrgb", knot, _hues(around))

    ball = scattered_directions(39, 1200)
    write_pcd(folder / "coloured_ball.pcd", ball, _hues(3.0 * np.pi * ball[:, 2]))


def _surface_points(mesh: Mesh, seed: int, count: int) -> Array:
    """Points (count, 3), independent and uniform over the area of `mesh`."""
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    pick, u, v = uniform(seed, 3, count)
    t = np.searchsorted(area, pick * area[-1])
    root, v = np.sqrt(u)[:, None], v[:, None]
    points: Array = (1.0 - root) * a[t] + root * (1.0 - v) * b[t] + root * v * c[t]
    return points


def _hues(angle: Array) -> Array:
    """Colours (n, 3) around the colour circle."""
    phase: Array = angle[:, None] - 2.0 * np.pi * np.arange(3) / 3.0
    return 0.5 + 0.5 * np.cos(phase)


def write_formats(folder: Path) -> None:
    """One small file a format: a bracket with flat faces, a coloured ball of points, a volume of two labels."""
    folder.mkdir(exist_ok=True)
    outline = np.array([[0, 0], [40, 0], [40, 8], [8, 8], [8, 30], [0, 30]], dtype=np.float64)
    points = np.vstack([np.insert(outline, 2, height, axis=1) for height in (0.0, 20.0)])
    sides = [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    polygons = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *sides]
    # The caps are concave: cut by hand along the inner corner.
    caps = [[5, 4, 3], [5, 3, 0], [3, 2, 0], [2, 1, 0]]
    triangles = np.array([*caps, *([c + 6, b + 6, a + 6] for a, b, c in caps), *halves(np.array(sides)).tolist()])
    write_ply(folder / "bracket.ply", points, triangles)
    write_stl(folder / "bracket.stl", points, triangles)
    packed = folder / "bracket.stl"
    (folder / "bracket.stl.gz").write_bytes(gzip_bytes(packed.read_bytes()))
    packed.unlink()
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    text += "".join(f"f {' '.join(str(corner + 1) for corner in polygon)}\n" for polygon in polygons)
    (folder / "bracket.zip").write_bytes(zip_bytes({"readme.txt": "a bracket\n", "parts/bracket.obj": text}))
    write_3mf(folder / "bracket.3mf", points, triangles)
    write_step(folder / "bracket.step", points, polygons)
    write_iges(folder / "bracket.igs", points, polygons)
    write_vtk(folder / "bracket.vtk", points, polygons)
    write_vtp(folder / "bracket.vtp", points, polygons)
    write_vtu(folder / "bracket.vtu", points, outline)
    write_dae(folder / "bracket.dae", points, polygons)
    write_x3d(folder / "bracket.x3d", points, polygons)
    write_fbx(folder / "bracket.fbx", points, polygons)

    ball = scattered_directions(39, 1200)  # that of coloured_ball.pcd
    hues = _hues(3.0 * np.pi * ball[:, 2])
    (folder / "ball.las").write_bytes(las_bytes(ball, hues))
    try:
        (folder / "ball.laz").write_bytes(las_bytes(ball, hues, packed=True))
    except ModuleNotFoundError:
        print("formats/ball.laz left out: it takes the package lazrs")
    # Two scanners that stand apart, one turned by a quarter about z: each sees a half.
    upper = ball[:, 2] > 0
    turn = (float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5)))
    x, y, z = ball[upper].T - np.array([[3.0], [1.0], [2.0]])
    seen = Scan("upper", np.stack([y, -x, z], axis=1), turn, (3.0, 1.0, 2.0), hues[upper])
    write_e57(folder / "ball.e57", [seen, Scan("lower", ball[~upper], colors=hues[~upper])])

    i, j, k = np.meshgrid(*(np.arange(size) for size in (24, 20, 12)), indexing="ij")
    labels = np.zeros(i.shape, dtype=np.uint8)
    labels[(i - 8) ** 2 + (j - 9) ** 2 * 2.25 + (k - 5) ** 2 * 4 < 49] = 1  # a ball of 3.5 mm, in voxels of these sizes
    labels[17:22, 4:16, 2:9] = 2
    spacing = (0.5, 0.75, 1.0)
    (folder / "labels.nii.gz").write_bytes(gzip_bytes(nifti_bytes(labels, spacing)))
    (folder / "labels.nrrd").write_bytes(nrrd_bytes(labels, spacing))
    (folder / "labels.tif").write_bytes(tiff_bytes(labels, spacing))
    (folder / "labels.npy").write_bytes(npy_bytes(labels))


def write_broken(folder: Path) -> None:
    """Files a reader has to refuse, in a way of its own for each format."""
    folder.mkdir(exist_ok=True)
    small = icosphere(2)

    def cut(name: str, share: float) -> None:
        """Keep the first part of a file that has just been written."""
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(share * len(data))])

    write_ply(folder / "truncated.ply", *small)
    cut("truncated.ply", 0.7)
    write_stl(folder / "truncated.stl", *small)
    cut("truncated.stl", 0.6)
    write_off(folder / "truncated.off", *small)
    cut("truncated.off", 0.55)
    write_glb(folder / "truncated.glb", *small)
    cut("truncated.glb", 0.8)

    quoted = {
        "bad_index.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 99\n",
        "bad_index.off": "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 -7\n",
        "bad_word.ply": (
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 zero 0\n0 1 0\n3 0 1 2\n"
        ),
        "empty.off": "OFF\n0 0 0\n",
        "huge_count.ply": (
            "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
            "property float z\nend_header\nnothing like four thousand million points"
        ),
        "mesh_in_disguise.stl": "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n",
        "nan.off": "OFF 4 2 0\n0 0 0\n1 0 0\nnan 1 0\n0 inf 1\n3 0 1 2\n3 0 1 3\n",
        "ragged.xyzn": "0 0 0 0 0 1\n1 0 0 0 0\n0 1 0 0 0 1\n",
        "ragged.xyzrgb": "0 0 0 1 0 0\n1 0 0\n0 1 0 0 1 0\n",
        "short.pcd": (
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100\nHEIGHT 1\n"
            "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 100\nDATA ascii\n0 0 0\n1 0 0\n0 1 0\n"
        ),
        "unknown.shape": "a shape in a format nobody reads\n",
        "zero_bytes.obj": "",
    }
    for name, text in quoted.items():
        (folder / name).write_bytes(text.encode("ascii"))
    (folder / "garbage.glb").write_bytes((uniform(41, 400) * 256.0).astype(np.uint8).tobytes())


def main() -> None:
    """Write every sample below the folder `--output`, by default the one this script lies in."""
    parser = argparse.ArgumentParser(description="Write the sample shapes.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="folder to write into")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    write_star_shaped(folder)
    write_not_star_shaped(folder)
    write_open(folder)
    write_clouds(folder)
    write_formats(folder / "formats")
    write_broken(folder / "broken")


if __name__ == "__main__":
    main()
