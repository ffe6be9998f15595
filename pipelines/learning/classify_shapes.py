"""Classify shapes from the coefficients of their shells: learned, or by the nearest neighbour; turned every which way.

Every model lies in a random pose. A network of a few thousand numbers mixes the shells' coefficients degree by degree,
which commutes with rotations, and learns a distance in which models of a class are close (neighbourhood components
analysis: Goldberger et al. 2004). With cross-shell invariants behind it, the pose does not matter and it starts as the
descriptor ``SHDOption.best()`` itself; without them, the same layer has to learn poses from examples. The trade-off:
learning needs labels, and with ten models a class there is little that a distance can learn beyond what it knows.

    python pipelines/learning/classify_shapes.py --models DIR --classification base/train.cla --output output/learning
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor, nn

import fsh3d_o3d as fsh
from fsh3d_o3d import torch as ft
from fsh3d_o3d.evaluation import find_models

SAMPLES = Path(__file__).parents[2] / "samples"
OPTION = fsh.SHDOption.best()
FOLDS = 5
SMALLEST_CLASS = 5  # one model for each fold
SHARPNESS = 40.0  # of the softmax over distances, which are within [0, 2]
BATCH, RATE = 128, 3e-3


class Embedding(nn.Module):
    """Functions on shells (n, R, b²) to unit vectors (n, d) in L1: mixed by degree, then invariant or as they are."""

    def __init__(self, functions: int, *, invariant: bool) -> None:
        super().__init__()
        self.mix = ft.ZonalConvolution(functions, functions, OPTION.bandwidth, bias=False)
        self.invariant = invariant
        with torch.no_grad():
            self.mix.weight.copy_(torch.eye(functions)[..., None].expand_as(self.mix.weight))

    def forward(self, coefficients: Tensor) -> Tensor:
        """Embed."""
        mixed = self.mix(coefficients)
        if self.invariant:
            mixed = ft.cross_shell_invariants(mixed, OPTION.power, OPTION.epsilon)
        return nn.functional.normalize(mixed.flatten(1), 1, dim=-1)


def described(models: Path, classification: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (n, R, b²), descriptors (n, d) and labels (n,) of models in classes that are large enough."""
    known = fsh.read_classification(classification)
    files = find_models(models, known.models).paths
    rows = []
    for place, group in enumerate(known.classes):
        own = [model for model in group.models if model in files]
        if group.miscellaneous or len(own) < SMALLEST_CLASS:
            continue
        signatures = [fsh.compute_signature(fsh.read_geometry(files[model]), OPTION, bandwidth=12) for model in own]
        rows += [(signature.coefficients, signature.feature, place) for signature in signatures]
    return tuple(map(np.array, zip(*rows, strict=True)))


def made_up(count: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of samples that are stretched at random, where there is no library at hand: easy, and quick."""
    rng, rows = np.random.default_rng(0), []
    for place, name in enumerate(("hand.ply", "horn.off", "starfish.ply", "trefoil_knot.ply")):
        mesh = fsh.read_geometry(SAMPLES / name)
        vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        for _ in range(count):
            stretched = fsh.MeshArrays(vertices @ (np.eye(3) + 0.25 * rng.standard_normal((3, 3))), triangles)
            signature = fsh.compute_signature(stretched, OPTION, bandwidth=12)
            rows.append((signature.coefficients, signature.feature, place))
    return tuple(map(np.array, zip(*rows, strict=True)))


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    """Rotations (n, 1, 3, 3), uniformly distributed."""
    q, r = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator))
    q = q * torch.sign(torch.diagonal(r, dim1=1, dim2=2))[:, None]
    return (q * torch.linalg.det(q)[:, None, None])[:, None]


def learn(network: Embedding, coefficients: Tensor, labels: Tensor, steps: int, generator: torch.Generator) -> None:
    """Make neighbours of what has the same label; poses are drawn anew for each step."""
    optimiser = torch.optim.Adam(network.parameters(), lr=RATE)
    for _ in range(steps):
        batch = torch.randperm(len(labels), generator=generator)[:BATCH]
        turned = coefficients[batch]
        if not network.invariant:
            turned = ft.rotate_coefficients(turned, random_rotations(len(batch), generator))
        embedded = network(turned)
        own = torch.eye(len(batch), dtype=torch.bool)
        nearness = (-SHARPNESS * torch.cdist(embedded, embedded, 1)).masked_fill(own, -torch.inf).log_softmax(1)
        same = (labels[batch][:, None] == labels[batch]) & ~own
        inside = nearness.masked_fill(~same, -torch.inf).logsumexp(1)[same.any(1)]
        optimiser.zero_grad()
        (-inside.mean()).backward()
        optimiser.step()


def hits(train: Tensor, train_labels: Tensor, test: Tensor, test_labels: Tensor) -> Tensor:
    """Whether the nearest neighbour in L1 has the label, for each."""
    return train_labels[torch.cdist(test, train, 1).argmin(1)] == test_labels


def main() -> int:
    """Cross-validate the four ways, print and draw."""
    parser = argparse.ArgumentParser(description="Classify shapes by learned and by given distances.")
    parser.add_argument("--models", type=Path, help="folder of models; stretched samples if not given")
    parser.add_argument("--classification", type=Path, help=".cla file of the models")
    parser.add_argument("--output", type=Path, default=Path("output/learning"), help="folder for the picture")
    parser.add_argument("--steps", type=int, default=60, help="of gradient descent, in each fold")
    options = parser.parse_args()
    if (options.models is None) != (options.classification is None):
        parser.error("--models and --classification belong together")
    options.output.mkdir(parents=True, exist_ok=True)
    given = made_up() if options.models is None else described(options.models, options.classification)
    coefficients, features, labels = map(torch.from_numpy, given)
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    # The descriptor's scale: every field of unit norm. Then each model in a pose of its own.
    coefficients = coefficients * (len(OPTION.frames) * OPTION.shell_fields.count) ** 0.5
    coefficients = ft.rotate_coefficients(coefficients, random_rotations(len(labels), generator))

    fold = torch.empty(len(labels), dtype=torch.int64)
    for label in labels.unique():
        own = torch.nonzero(labels == label)[:, 0]
        fold[own[torch.randperm(len(own), generator=generator)]] = torch.arange(len(own)) % FOLDS
    networks = {"learned, invariant": True, "learned, not invariant": False}
    scores: dict[str, list[Tensor]] = {name: [] for name in ("SHDOption.best()", "as they lie", *networks)}
    start = time.process_time()
    for part in range(FOLDS):
        train, test = fold != part, fold == part
        split = labels[train], labels[test]
        generator = torch.Generator().manual_seed(part)  # each fold by itself, so that they may be run side by side
        scores["SHDOption.best()"].append(hits(features[train], split[0], features[test], split[1]))
        flat = nn.functional.normalize(coefficients.flatten(1), 1, dim=-1)
        scores["as they lie"].append(hits(flat[train], split[0], flat[test], split[1]))
        for name, invariant in networks.items():
            network = Embedding(coefficients.shape[1], invariant=invariant)
            learn(network, coefficients[train], split[0], options.steps, generator)
            with torch.no_grad():
                first, second = network(coefficients[train]), network(coefficients[test])
            scores[name].append(hits(first, split[0], second, split[1]))

    count = sum(parameter.numel() for parameter in network.parameters())
    print(f"{len(labels)} models, {len(labels.unique())} classes, {count} learned numbers, {FOLDS} folds")
    print(f"learning took {time.process_time() - start:.0f} s of CPU")
    results = {name: float(torch.cat(parts).float().mean()) for name, parts in scores.items()}
    for name, rate in results.items():
        # Of a share: what other draws of as many models would scatter by.
        print(f"{name:<24} {100 * rate:5.1f} % ± {100 * (rate * (1 - rate) / len(labels)) ** 0.5:.1f}")
    figure = Figure(figsize=(6.4, 2.2), layout="constrained")
    axes = figure.subplots()
    axes.barh(list(results), [100 * rate for rate in results.values()], color=["C0", "0.7", "C1", "0.7"])
    axes.bar_label(axes.containers[0], fmt="%.1f", padding=3)
    axes.set(xlim=(0, 109), xlabel="models whose nearest neighbour is of their class, %")
    axes.invert_yaxis()
    figure.savefig(options.output / "classify_shapes.png", dpi=120)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
