"""Tables of figures with targets: on the terminal, and as JSON, Markdown and a picture each in a folder."""

from __future__ import annotations

import importlib.util
import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmarks._measure import Timing

Cell = float | str | bool | Timing | None


@dataclass(frozen=True)
class Check:
    """A figure held against its target."""

    quantity: str
    """What the figure is."""
    value: float
    """The figure."""
    relation: Literal["<=", ">="]
    """On which side of the limit it should lie."""
    limit: float
    """The target."""

    @property
    def met(self) -> bool:
        """Whether the target is reached; a figure that is not a number reaches none."""
        return self.value <= self.limit if self.relation == "<=" else self.value >= self.limit

    def __str__(self) -> str:
        return f"{self.quantity} {self.relation} {self.limit:g}"


@dataclass(frozen=True)
class Column:
    """How one figure of a row is shown."""

    key: str
    """Its name in the rows."""
    heading: str
    """Its name for people, with the unit."""
    spec: str = ""
    """Format specification of numbers."""
    scale: float = 1.0
    """What a figure is multiplied by before it is shown: 1e3 shows seconds as milliseconds."""

    def show(self, cell: Cell) -> str:
        """Return the text of a cell; a time as median (fastest–slowest)."""
        if cell is None:
            return "–"
        if isinstance(cell, bool):
            return "yes" if cell else "no"
        if isinstance(cell, str):
            return cell
        if isinstance(cell, Timing):
            parts = (format(self.scale * value, self.spec) for value in (cell.median, cell.minimum, cell.maximum))
            return "{} ({}–{})".format(*parts)
        return format(self.scale * cell if self.scale != 1 else cell, self.spec)


@dataclass(frozen=True)
class Row:
    """One case."""

    cells: Mapping[str, Cell]
    """Figures by column."""
    checks: tuple[Check, ...] = ()
    """Those that have a target."""

    @property
    def target(self) -> str:
        """The targets in words."""
        return ", ".join(map(str, self.checks)) or "–"

    @property
    def verdict(self) -> str:
        """``"pass"``, or what misses by how much; a dash where there is no target."""
        missed = [f"{check.quantity} {check.value:.3g}" for check in self.checks if not check.met]
        return "MISS: " + ", ".join(missed) if missed else "pass" if self.checks else "–"


@dataclass(frozen=True)
class Curve:
    """One line of a picture."""

    label: str
    """What it shows."""
    x: Sequence[float]
    """Where."""
    y: Sequence[float]
    """What."""
    dashed: bool = False
    """Drawn as a dashed line in the colour of the curve before: the other side of a comparison."""


@dataclass(frozen=True)
class Plot:
    """A picture of a table: curves over logarithmic axes."""

    x_label: str
    """Name of the horizontal axis."""
    y_label: str
    """Name of the vertical axis, with the unit."""
    curves: tuple[Curve, ...]
    """What to draw."""
    level: float | None = None
    """A horizontal line."""
    level_label: str = "target"
    """What it is."""


@dataclass(frozen=True)
class Table:
    """What one benchmark found."""

    name: str
    """Of files and for ``--only``."""
    title: str
    """One line."""
    columns: tuple[Column, ...]
    """What is shown of every row."""
    rows: tuple[Row, ...]
    """The cases."""
    plot: Plot | None = None
    """A picture of them."""
    notes: tuple[str, ...] = field(default=())
    """What a reader must know to read the figures right."""

    @property
    def missed(self) -> tuple[str, ...]:
        """The missed targets, a line per row, which its first columns name."""
        lines = []
        for row in self.rows:
            if any(not check.met for check in row.checks):
                case = ", ".join(
                    f"{column.heading} {column.show(row.cells.get(column.key))}" for column in self.columns[:5]
                )
                missed = "; ".join(f"{check} but {check.value:.3g}" for check in row.checks if not check.met)
                lines.append(f"{self.name}: {case}: {missed}")
        return tuple(lines)

    def text(self) -> str:
        """Return the table aligned for a terminal."""
        grid = self._grid()
        widths = [max(len(line[i]) for line in grid) for i in range(len(grid[0]))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in grid
        ]
        lines.insert(1, "  ".join("-" * width for width in widths))
        return "\n".join([self.title, "=" * len(self.title), *lines, *self.notes])

    def markdown(self) -> str:
        """Return the table as Markdown."""
        heading, *body = ("| " + " | ".join(line) + " |" for line in self._grid())
        rule = "|" + "---|" * (len(self.columns) + 2)
        return "\n".join([f"## {self.title}", "", heading, rule, *body, "", *(f"{note}  " for note in self.notes)])

    def record(self) -> dict[str, Any]:
        """Return the table for JSON; times in seconds, figures that are not finite as null."""
        return {
            "name": self.name,
            "title": self.title,
            "notes": list(self.notes),
            "rows": [
                {
                    **{key: _plain(cell) for key, cell in row.cells.items()},
                    "checks": [
                        {
                            "quantity": check.quantity,
                            "value": _plain(check.value),
                            "target": f"{check.relation} {check.limit:g}",
                            "met": check.met,
                        }
                        for check in row.checks
                    ],
                }
                for row in self.rows
            ],
        }

    def _grid(self) -> list[list[str]]:
        heading = [column.heading for column in self.columns] + ["target", "verdict"]
        return [heading] + [
            [column.show(row.cells.get(column.key)) for column in self.columns] + [row.target, row.verdict]
            for row in self.rows
        ]


def write_tables(folder: Path, tables: Sequence[Table], environment: Mapping[str, str]) -> list[Path]:
    """Write ``results.json``, ``results.md`` and, where Matplotlib is installed, pictures; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    document = {"environment": dict(environment), "tables": [table.record() for table in tables]}
    data, text = folder / "results.json", folder / "results.md"
    data.write_text(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    parts = ["# Benchmarks", "", *(f"- {key}: {value}" for key, value in environment.items()), ""]
    for table in tables:
        parts += [table.markdown(), ""]
        if table.plot is not None and _drawable():
            parts += [f"![{table.title}]({table.name}.png)", ""]
    text.write_text("\n".join(parts), encoding="utf-8")
    pictures = [_draw(folder, table, table.plot) for table in tables if table.plot is not None and _drawable()]
    return [data, text, *pictures]


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Timing):
        return {"median": cell.median, "minimum": cell.minimum, "maximum": cell.maximum, "cores": cell.cores}
    if isinstance(cell, float) and not math.isfinite(cell):
        return None
    return cell


def _drawable() -> bool:
    return importlib.util.find_spec("matplotlib") is not None


def _draw(folder: Path, table: Table, plot: Plot) -> Path:
    path = folder / f"{table.name}.png"
    _figure(table, plot).savefig(path, dpi=130)
    return path


def _figure(table: Table, plot: Plot) -> Any:
    """The picture of a table, with its legend beside the curves."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator

    figure = Figure(figsize=(8.5, 4.5), layout="constrained")
    axes = figure.subplots()
    color = -1
    for place, curve in enumerate(plot.curves):
        color += not curve.dashed
        # Curves that lie on each other are told apart by their markers: hollow, smaller and smaller.
        axes.plot(
            curve.x,
            curve.y,
            label=curve.label,
            color=f"C{color}",
            linestyle="--" if curve.dashed else "-",
            linewidth=1.2,
            marker="osD^vP*X"[place % 8],
            markersize=max(4, 9 - place),
            markerfacecolor="none",
        )
    if plot.level is not None:
        axes.axhline(plot.level, color="0.4", linestyle=":", label=plot.level_label)
    axes.set(xscale="log", yscale="log", xlabel=plot.x_label, ylabel=plot.y_label)
    axes.set_title(textwrap.fill(table.title, 80), fontsize="medium", loc="left")
    places = sorted({x for curve in plot.curves for x in curve.x})
    axes.set_xticks(places, [f"{place:g}" for place in places])
    low, high = axes.get_ylim()
    if high < 300 * low:  # powers of ten alone would be one or two labels
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1), borderaxespad=0, fontsize="small")
    return figure
