"""Values that travel: what grids, options, shapes and results have in common.

A value is a frozen dataclass. It pickles, also to processes that are spawned, and is as immutable there as it was here;
values with equal fields are equal; what is printed of one fits on a line.
"""

from __future__ import annotations

import base64
import dataclasses
import html
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np

if TYPE_CHECKING:
    from typing import dataclass_transform
else:

    def dataclass_transform(**_):  # Python 3.10 does not have it yet
        return lambda function: function


T = TypeVar("T")

_SHOWN = 4  # numbers of an array, or members of a tuple, that are shown rather than counted
_LONGEST = 60  # characters of a value inside of another, or of a text


@overload
def value(cls: type[T], /) -> type[T]: ...
@overload
def value(*, kw_only: bool = False) -> Callable[[type[T]], type[T]]: ...
@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(dataclasses.field,))
def value(cls: Any = None, /, *, kw_only: bool = False) -> Any:
    """Make a class a frozen dataclass whose instances are values; what the class defines itself stays."""

    def made(given: type[Any]) -> type[Any]:
        own = {name for name in _SHARED if name in vars(given)}
        result: type[Any] = dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=kw_only)(given)
        for name in _SHARED.keys() - own:
            setattr(result, name, _SHARED[name])
        return result

    return made if cls is None else made(cls)


def _reduce(self: Any) -> tuple[Any, ...]:
    """The fields alone, without what is kept beside them; NumPy's pickles forget that arrays are read-only."""
    fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
    sealed = [name for name, part in fields.items() if _is_sealed(part)]
    return _restored, (type(self), {name: _plain(part) for name, part in fields.items()}, sealed)


def _restored(cls: type[Any], fields: dict[str, Any], sealed: list[str]) -> Any:
    result = object.__new__(cls)
    vars(result).update(fields, **{name: _sealed(fields[name]) for name in sealed})
    return result


def _is_sealed(part: Any) -> bool:
    if isinstance(part, tuple):
        return any(map(_is_sealed, part))
    return isinstance(part, MappingProxyType) or (isinstance(part, np.ndarray) and not part.flags.writeable)


def _plain(part: Any) -> Any:
    return dict(part) if isinstance(part, MappingProxyType) else part  # a mapping proxy does not pickle


def _sealed(part: Any) -> Any:
    if isinstance(part, dict):
        return MappingProxyType({name: _sealed(inner) for name, inner in part.items()})
    if isinstance(part, np.ndarray):
        part.setflags(write=False)
    return tuple(map(_sealed, part)) if type(part) is tuple else part


def _equal(self: Any, other: Any) -> Any:
    if type(other) is not type(self):
        return NotImplemented
    return self is other or all(
        _same(getattr(self, field.name), getattr(other, field.name)) for field in dataclasses.fields(self)
    )


def _same(first: Any, second: Any) -> bool:
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind == second.dtype.kind == "f")
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(_same(part, second[name]) for name, part in first.items())
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_same, first, second))
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return False
    return bool(first == second or (first != first and second != second))  # NaN says that there is no number


def _hash(self: Any) -> int:
    """Of the sizes of arrays, not of what is in them: equal values have equal ones, and it takes no time."""
    return hash((type(self), *(_hashed(getattr(self, field.name)) for field in dataclasses.fields(self))))


def _hashed(part: Any) -> Any:
    if isinstance(part, np.ndarray):
        return part.shape
    if isinstance(part, Mapping):
        return frozenset(part)
    return tuple(map(_hashed, part)) if isinstance(part, (tuple, list)) else part if part == part else None


def _line(self: Any) -> str:
    """Bandwidth first where there is one, then fields that are not at their defaults."""
    parts = {
        field.name: getattr(self, field.name) for field in dataclasses.fields(self) if not _at_default(self, field)
    }
    if not isinstance(getattr(type(self), "bandwidth", None), property):
        return f"{type(self).__name__}({_listed(parts)})"
    return f"{type(self).__name__}({_listed({'bandwidth': self.bandwidth, **parts})})"


def _at_default(self: Any, field: dataclasses.Field[Any]) -> bool:
    make = field.default_factory
    return _same(getattr(self, field.name), field.default if make is dataclasses.MISSING else make())


def _listed(parts: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={shown(part)}" for name, part in parts.items())


def shown(part: Any) -> str:
    """Return a field as a few words: numbers rounded, arrays and long tuples by their size."""
    if isinstance(part, np.ndarray):
        if part.ndim == 1 and part.size <= _SHOWN:
            return shown(tuple(part.tolist()))
        return f"<{part.dtype} {'×'.join(map(str, part.shape))}>"
    if isinstance(part, float):
        return f"{part:.6g}"
    if isinstance(part, bytes):
        return f"<{len(part)} bytes>"
    if isinstance(part, Mapping):
        return f"{{{_listed(part)}}}" if len(part) <= _SHOWN else f"<{len(part)} by name>"
    if isinstance(part, (tuple, list)):
        if len(part) > _SHOWN or any(dataclasses.is_dataclass(inner) for inner in part):
            return f"<{len(part)} {type(part[0]).__name__}>"
        return f"({', '.join(map(shown, part))})"
    text = repr(part)
    if len(text) <= _LONGEST:
        return text
    return f"{text[: _LONGEST - 1]}…" if isinstance(part, str) else f"{type(part).__name__}(…)"


_painters: list[Callable[[Any], bytes | None]] = []


def draw_values_with(painter: Callable[[Any], bytes | None]) -> None:
    """Say what draws a value: it returns a PNG, or None for what has no form. Called by what is loaded above."""
    _painters[:] = [painter]


def _html(self: Any) -> str | None:
    """A picture and the line, for a notebook; None, which leaves the line alone, for what has no form."""
    picture = _painters[0](self) if _painters else None
    if picture is None:
        return None
    image = base64.b64encode(picture).decode("ascii")
    line = html.escape(repr(self))
    return (
        '<div style="display:flex;align-items:center;gap:12px">'
        f'<img alt="" src="data:image/png;base64,{image}"><code>{line}</code></div>'
    )


_SHARED: dict[str, Any] = {
    "__reduce__": _reduce,
    "__eq__": _equal,
    "__hash__": _hash,
    "__repr__": _line,
    "_repr_html_": _html,
}
