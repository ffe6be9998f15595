"""Writers of CAD files with flat faces: STEP and IGES. The same polygons give the same bytes on every machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _writers import Array, rounded

Polygons = Sequence[Sequence[int]]
_STEP_HEAD = (
    "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    "FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n"
)
_IGES_GLOBAL = (
    "1H,,1H;,4Hpart,4Hpart,0H,0H,32,38,6,308,15,4Hpart,1.,2,2HMM,1,0.01,15H20200101.000000,1.E-07,10.,0H,0H,11,0;"
)
_IGES_WIDTH = 64  # characters of parameters in a line; eight more point back to the entity


def normal_of(points: Array) -> Array:
    """Unit normal of a polygon (n, 3), whose corners turn left around it."""
    around = np.cross(points - points[0], np.roll(points, -1, axis=0) - points[0]).sum(axis=0)
    unit: Array = around / np.linalg.norm(around)
    return unit


def step_bytes(points: Array, polygons: Polygons) -> bytes:
    """A solid in millimetres between flat faces, whose corners turn left seen from outside."""
    points = rounded(points)
    entities: list[str] = []

    def add(text: str) -> int:
        entities.append(text)
        return len(entities)

    def vector(name: str, values: Array) -> int:
        return add(f"{name}('',({','.join(repr(value) for value in rounded(values, 12).tolist())}))")

    places = [vector("CARTESIAN_POINT", point) for point in points]
    vertices = [add(f"VERTEX_POINT('',#{place})") for place in places]
    edges: dict[tuple[int, int], int] = {}

    def edge(a: int, b: int) -> int:
        low, high = min(a, b), max(a, b)
        if (low, high) not in edges:
            along = points[high] - points[low]
            towards = add(f"VECTOR('',#{vector('DIRECTION', along / np.linalg.norm(along))},1.)")
            line = add(f"LINE('',#{places[low]},#{towards})")
            edges[low, high] = add(f"EDGE_CURVE('',#{vertices[low]},#{vertices[high]},#{line},.T.)")
        return add(f"ORIENTED_EDGE('',*,*,#{edges[low, high]},{'.T.' if a < b else '.F.'})")

    def listed(numbers: Sequence[int]) -> str:
        return ",".join(f"#{number}" for number in numbers)

    faces = []
    for polygon in polygons:
        corners = points[list(polygon)]
        sides = [edge(a, b) for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)]
        loop = add(f"EDGE_LOOP('',({listed(sides)}))")
        bound = add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
        along = corners[1] - corners[0]
        axes = vector("DIRECTION", normal_of(corners)), vector("DIRECTION", along / np.linalg.norm(along))
        frame = add(f"AXIS2_PLACEMENT_3D('',#{places[polygon[0]]},#{axes[0]},#{axes[1]})")
        plane = add(f"PLANE('',#{frame})")
        faces.append(add(f"ADVANCED_FACE('',(#{bound}),#{plane},.T.)"))
    shell = add(f"CLOSED_SHELL('',({listed(faces)}))")
    solid = add(f"MANIFOLD_SOLID_BREP('part',#{shell})")
    context = add("APPLICATION_CONTEXT('automotive design')")
    purpose = add(f"PRODUCT_CONTEXT('',#{context},'mechanical')")
    product = add(f"PRODUCT('part','part','',(#{purpose}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
    stage = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{context},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',#{formation},#{stage})")
    shape = add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
    units = [
        add("(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))"),
        add("(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.))"),
        add("(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT())"),
    ]
    exact = add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#{units[0]},'distance_accuracy_value','')")
    where = add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{exact})) "
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({listed(units)})) REPRESENTATION_CONTEXT('',''))"
    )
    origin = (
        vector("CARTESIAN_POINT", np.zeros(3)),
        vector("DIRECTION", np.eye(3)[2]),
        vector("DIRECTION", np.eye(3)[0]),
    )
    frame = add(f"AXIS2_PLACEMENT_3D('',#{origin[0]},#{origin[1]},#{origin[2]})")
    body = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',(#{frame},#{solid}),#{where})")
    add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{body})")
    data = "".join(f"#{number}={text};\n" for number, text in enumerate(entities, 1))
    return f"{_STEP_HEAD}{data}ENDSEC;\nEND-ISO-10303-21;\n".encode("ascii")


def iges_bytes(points: Array, polygons: Polygons) -> bytes:
    """Trimmed planes in millimetres: of each polygon a plane, its outline on it, and the part inside that."""
    points = rounded(points)
    directory: list[str] = []
    parameters: list[str] = []

    def add(kind: int, *values: object, form: int = 0, below: bool = False) -> int:
        """Add an entity and return its number: of the first of its two lines in the directory."""
        number = 2 * (len(directory) // 2) + 1
        text = (
            ",".join([str(kind), *(repr(value) if isinstance(value, float) else str(value) for value in values)]) + ";"
        )
        lines = [text[at : at + _IGES_WIDTH] for at in range(0, len(text), _IGES_WIDTH)]
        status = "00010000" if below else "00000000"
        first = [kind, len(parameters) + 1, 0, 0, 0, 0, 0, 0]
        directory.append("".join(f"{value:8d}" for value in first) + status)
        directory.append("".join(f"{value:8d}" for value in (kind, 0, 0, len(lines), form, 0, 0)) + " " * 8 + f"{0:8d}")
        parameters.extend(f"{line:<{_IGES_WIDTH}}{number:8d}" for line in lines)
        return number

    for polygon in polygons:
        corners = points[list(polygon)]
        normal = normal_of(corners)
        plane = add(108, *normal.tolist(), float(normal @ corners[0]), 0, *corners[0].tolist(), 1.0, below=True)
        ends = np.roll(corners, -1, axis=0)
        sides = [add(110, *a.tolist(), *b.tolist(), below=True) for a, b in zip(corners, ends, strict=True)]
        outline = add(102, len(sides), *sides, below=True)
        on_plane = add(142, 0, plane, 0, outline, 2, below=True)
        add(144, plane, 1, 0, on_plane)
    width = 72
    head = [_IGES_GLOBAL[at : at + width] for at in range(0, len(_IGES_GLOBAL), width)]
    sections = {"S": ["a part with flat faces"], "G": head, "D": directory, "P": parameters}
    lines = [
        f"{line:<{width}}{letter}{number:7d}\n"
        for letter, rows in sections.items()
        for number, line in enumerate(rows, 1)
    ]
    ending = "".join(f"{letter}{len(rows):7d}" for letter, rows in sections.items())
    return ("".join(lines) + f"{ending:<{width}}T{1:7d}\n").encode("ascii")


def write_step(path: Path, points: Array, polygons: Polygons) -> None:
    """STEP with a solid between flat faces."""
    path.write_bytes(step_bytes(points, polygons))


def write_iges(path: Path, points: Array, polygons: Polygons) -> None:
    """IGES with trimmed planes."""
    path.write_bytes(iges_bytes(points, polygons))
