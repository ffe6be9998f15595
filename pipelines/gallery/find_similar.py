"""Find shapes like one in hand: by features first, by alignment among the best.

A rotation-invariant feature makes a shape a row of numbers, and a library a matrix: thousands of shapes are compared in
a moment, none of them has to be aligned, and what lies on its side is found as well. It pays for that by forgetting how
the degrees sit relative to each other. Where that matters, align the few best candidates with the query and compare the
coefficients themselves: under a millisecond each, thus only for as many as one is prepared to look at. Here both orders
stand beside each other; in a library on disk, ``fsh3d index`` and ``fsh3d query`` do the same.

    python pipelines/gallery/find_similar.py --output output/gallery
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import fsh3d_o3d as fsh
from fsh3d_o3d.descriptors import SHDDescriptor
from fsh3d_o3d.files import atomic_write_bytes, read_geometry_arrays
from fsh3d_o3d.report import encode_png, render_thumbnail, side_by_side

SAMPLES = Path(__file__).parents[2] / "samples"
LIBRARY = (
    "bennu_like.ply",
    "bumpy_ellipsoid.obj",
    "cushion_quads.obj",
    "double_torus.off",
    "gem.stl",
    "hand.ply",
    "horn.off",
    "spiky_star.glb",
    "starfish.ply",
    "stone_degree8.ply",
    "trefoil_knot.ply",
    "vase_quads.obj",
)
QUERIES = ("starfish_posed.ply", "bennu_like_low.ply", "trefoil_cloud.xyzrgb")
SHOWN, ALIGNED, SIZE = 4, 6, 92


def main() -> int:
    """Rank the library for each query, with and without alignment; the exit code is 1 if a twin is not first."""
    parser = argparse.ArgumentParser(description="Find shapes like one in hand.")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the picture")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)

    shapes = {name: read_geometry_arrays(SAMPLES / name) for name in (*QUERIES, *LIBRARY)}
    search = SHDDescriptor(fsh.SHDOption.best(), rerank=ALIGNED)
    described = {name: search.describe(shape) for name, shape in shapes.items()}
    library = np.stack([described[name] for name in LIBRARY])
    queries = np.stack([described[name] for name in QUERIES])
    rows, columns = search.option.feature_shape  # what follows behind the feature are coefficients for alignment
    by_feature = fsh.descriptor_distances(queries[:, : rows * columns], library[:, : rows * columns], search.option)
    aligned = search.distances(queries, library)

    pictures = {name: render_thumbnail(shape, width=SIZE, height=SIZE) for name, shape in shapes.items()}
    strips, twins = [], 0
    for index, query in enumerate(QUERIES):
        images, captions = [pictures[query]], ["query"]
        for title, distances in (("feature", by_feature[index]), ("aligned", aligned[index])):
            order = np.argsort(distances, kind="stable")[:SHOWN]
            print(f"{query:<20} {title}: " + ", ".join(f"{LIBRARY[i]} {distances[i]:.2f}" for i in order))
            images += [pictures[LIBRARY[i]] for i in order]
            captions += [f"{title} {distances[i]:.2f}" for i in order]
        twins += LIBRARY[np.argmin(aligned[index])].split("_")[0].split(".")[0] == query.split("_")[0]
        strips.append(side_by_side(images, captions))
    atomic_write_bytes(folder / "find_similar.png", encode_png(np.concatenate(strips)))
    return 0 if twins == len(QUERIES) else 1


if __name__ == "__main__":
    raise SystemExit(main())
