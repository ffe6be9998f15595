"""Reconstruct samples from their spherical harmonics, and compare shapes by their features.

The job that most users come with first: a file in, a compact description and a clean closed mesh out, with figures that
say how good it is. Three inputs show the trade-offs: a star-shaped mesh, whose detail is limited by the bandwidth; a
cloud with noise, outliers and a hole, where the fit has to decide what to believe; and a shape with a handle, which
takes a field on many shells. Then features that no rotation changes tell which of the samples are the same shape, one
is laid onto its copy from an unknown pose, and all go into an index that is asked what is most like it.

    python pipelines/demo.py --output output/demo
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main as fsh3d
from fsh3d_o3d.report import library_thumbnail

SAMPLES = Path(__file__).parents[1] / "samples"


COMPARED = ("bennu_like.ply", "bennu_like_low.ply", "gem.stl", "gem_rotated.stl", "starfish.ply", "starfish_posed.ply")


def _compare(features: Path) -> None:
    """Print the distances between the compared samples: small for what is the same shape turned, moved or remeshed."""
    with np.load(features) as file:
        distances = fsh.descriptor_distances(file["features"], file["features"], fsh.SHDOption.best())
    print("Distances between features (0 same, 2 nothing in common):")
    for name, row in zip(COMPARED, distances, strict=True):
        print(f"  {name:<20}", *(f"{value:5.2f}" for value in row))


def _search(folder: Path) -> int:
    """Index the samples, ask for what is like one of them, and write a page."""
    library = fsh.ShapeIndex.open(folder / "samples.fsh", create=True)
    paths = sorted(path for path in SAMPLES.iterdir() if path.suffix in {".ply", ".off", ".obj", ".stl", ".glb"})
    library.add_files(paths, thumbnail=library_thumbnail)
    print(f"{len(library)} samples in the index {folder / 'samples.fsh'}; what is most like gem_rotated.stl:")
    wanted = str(SAMPLES / "gem_rotated.stl")
    return fsh3d(["query", str(folder / "samples.fsh"), wanted, "--top", "5", "--report", str(folder / "hits.html")])


def main() -> int:
    """Run the demonstration; the exit code is 0 if all of it worked."""
    parser = argparse.ArgumentParser(description="Reconstruct sample shapes from their spherical harmonics.")
    parser.add_argument("--output", type=Path, default=Path("output/demo"), help="folder for the results")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    worst = 0
    for name, source, options in (
        ("bennu_like", "bennu_like.ply", ["--bandwidth", "64"]),
        ("bennu_cloud", "bennu_cloud.ply", ["--bandwidth", "33"]),
        ("trefoil_knot", "trefoil_knot.ply", ["--method", "shells", "--bandwidth", "24", "--resolution", "96"]),
    ):
        stem = folder / name
        results = [f"{stem}.ply", "--save", f"{stem}.npz", "--picture", f"{stem}.png", "--report", f"{stem}.html"]
        code = fsh3d(["reconstruct", str(SAMPLES / source), *results, *options])
        worst = max(worst, code)
    features = folder / "features.npz"
    worst = max(worst, fsh3d(["describe", *(str(SAMPLES / name) for name in COMPARED), "-o", str(features)]))
    if worst == 0:
        _compare(features)
        # A spiral, which fits in one pose only: turned, moved and in other units.
        turned = folder / "horn_turned.ply"
        matrix = np.diag([25.4, 25.4, 25.4, 1.0])
        matrix[:3, :3] @= Rotation.from_rotvec([1.0, 1.2, -0.8]).as_matrix()
        matrix[:3, 3] = 3, -40, 12
        fsh.write_geometry(turned, fsh.read_geometry(SAMPLES / "horn.off").transform(matrix))
        aligned = [str(folder / "horn_aligned.ply"), "--picture", str(folder / "horn_aligned.png")]
        worst = max(worst, fsh3d(["align", str(turned), str(SAMPLES / "horn.off"), "-o", *aligned]))
        worst = max(worst, _search(folder))
        print(f"Open {folder / 'bennu_like.png'} for a picture; {folder / 'bennu_like.html'} and hits.html for pages.")
    return worst


if __name__ == "__main__":
    raise SystemExit(main())
