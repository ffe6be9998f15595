"""Reconstruct every model of a library by the method that suits it, and tabulate how well that went.

Before a library is given over to a method one wants to know what it will do to the worst of its models. Each model is
reconstructed as ``fsh3d reconstruct`` does without further options, and gets a row in a table of comma-separated
values; rows that are there already are not made again, so that a long run can be stopped and taken up. Models are taken
in a shuffled order: whatever part of them is done says something about all.

    python pipelines/reconstruct_library.py samples --output output/library.csv --bandwidth 16
    python pipelines/reconstruct_library.py psb/models --output psb.csv
"""

from __future__ import annotations

import argparse
import csv
import random
import time
import warnings
from pathlib import Path

import numpy as np

import fsh3d_o3d as fsh

COLUMNS = ("file", "method", "way", "rmse", "maximum", "coefficients", "topology_kept", "closed", "seconds", "failure")
SEED = 15  # of the order of the models


def reconstructed(path: Path, name: str, bandwidth: int | None) -> dict[str, object]:
    """Return the row of one model; seconds are of CPU."""
    started = time.process_time()
    row: dict[str, object] = {"file": name}
    try:
        result = fsh.reconstruct(fsh.read_geometry(path), bandwidth=bandwidth)
    except ValueError as error:
        row["failure"] = " ".join(str(error).split())
    else:
        error = result.error.relative()
        kept = next(trial.topology_kept for trial in result.trials if trial.way == result.way)
        row |= {"method": result.method, "way": result.way, "coefficients": result.coefficients}
        row |= {"rmse": f"{error.rmse:.6f}", "maximum": f"{error.maximum:.6f}", "topology_kept": kept}
        row["closed"] = result.to_triangle_mesh().is_edge_manifold(allow_boundary_edges=False)
    return row | {"seconds": f"{time.process_time() - started:.1f}"}


def summary(rows: list[dict[str, str]]) -> str:
    """Return the table of ways: how many took each, how far they are off, and what they cost."""
    done = [row for row in rows if not row["failure"]]
    lines = [
        f"{len(done)} of {len(rows)} models reconstructed, {sum(row['closed'] == 'True' for row in done)} closed",
        "",
        "| way | models | RMSE median | 90 % | largest | over 1 % | CPU s, median |",
        "|---|---|---|---|---|---|---|",
    ]
    ways = sorted({row["way"] for row in done}, key=lambda way: -sum(row["way"] == way for row in done))
    for way in [*ways, "all"]:
        chosen = [row for row in done if way in ("all", row["way"])]
        rmse = 100 * np.array([float(row["rmse"]) for row in chosen])
        seconds = np.median([float(row["seconds"]) for row in chosen])
        lines.append(
            f"| {way} | {len(chosen)} | {np.median(rmse):.2f} % | {np.quantile(rmse, 0.9):.2f} % | {rmse.max():.2f} %"
            f" | {np.count_nonzero(rmse > 1)} | {seconds:.1f} |"
        )
    lines += [f"\nnot reconstructed: {row['file']}: {row['failure']}" for row in rows if row["failure"]]
    return "\n".join(lines)


def main() -> int:
    """Fill the table and print its summary; the exit code is 1 if a model was not reconstructed."""
    parser = argparse.ArgumentParser(description="Reconstruct every model of a folder and tabulate the errors.")
    parser.add_argument("folder", type=Path, help="the models; other files are passed over")
    parser.add_argument("--output", type=Path, default=Path("output/library.csv"), help="the table; added to")
    parser.add_argument("--bandwidth", type=int, help="of radial and conformal shapes (64 if not given)")
    parser.add_argument("--most", type=int, help="stop after so many models")
    options = parser.parse_args()
    readable = (".off", ".obj", ".ply", ".stl", ".glb", ".gltf")
    paths = sorted(path for path in options.folder.rglob("*") if path.suffix.lower() in readable)
    random.Random(SEED).shuffle(paths)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.touch()
    with options.output.open(newline="", encoding="utf-8") as file:
        known = {row["file"] for row in csv.DictReader(file)}
    warnings.simplefilter("ignore")  # what they say is in the table
    with options.output.open("a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, restval="")
        if not known:
            table.writeheader()
        for path in paths[: options.most]:
            name = path.relative_to(options.folder).as_posix()
            if name not in known:
                table.writerow(reconstructed(path, name, options.bandwidth))
                file.flush()
    with options.output.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    print(summary(rows))
    return 1 if any(row["failure"] for row in rows) else 0


if __name__ == "__main__":
    raise SystemExit(main())
