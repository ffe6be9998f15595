"""Reader for the ``.cla`` files of the Princeton Shape Benchmark: which model belongs to which class."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from fsh3d_o3d._regular_file import open_regular
from fsh3d_o3d._value import value

__all__ = ["Classification", "ShapeClass", "read_classification"]

_ROOT = "0"
_MISCELLANEOUS = "-1"
_LARGEST_FILE = 64 * 2**20  # bytes; the benchmark's files have ten thousand


@value
class ShapeClass:
    """A class of models."""

    name: str
    """The class's own name, one word."""
    parents: tuple[str, ...]
    """Names of the classes above it, from the root down."""
    models: tuple[str, ...]
    """Ids of the models that belong to this class itself, not to one below it."""

    @property
    def full_name(self) -> str:
        """The name with those of its parents: ``aircraft/airplane/F117``."""
        return "/".join((*self.parents, self.name))

    @property
    def miscellaneous(self) -> bool:
        """Whether this is the benchmark's class ``-1`` of models that belong together in nothing."""
        return self.name == _MISCELLANEOUS


@value
class Classification:
    """The content of a classification file."""

    classes: tuple[ShapeClass, ...]
    """All classes in the order of the file, those without models included."""

    @property
    def models(self) -> tuple[str, ...]:
        """Ids of all models in the order of the file."""
        return tuple(model for group in self.classes for model in group.models)

    @property
    def labels(self) -> tuple[int, ...]:
        """For each of ``models`` the position of its class in ``classes``."""
        return tuple(index for index, group in enumerate(self.classes) for _ in group.models)


def read_classification(path: str | os.PathLike[str]) -> Classification:
    """Read a classification file of the Princeton Shape Benchmark, version 1.

    ``PSB 1``, the numbers of classes and models, then each class as ``name parent count`` and as many model ids. The
    parent is a class named before, or ``0``. Any white space separates, so line ends may be those of any system.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is no such text, is truncated or contradicts itself: one line with the file's name, the
            line's number and the reason.

    Example:
        >>> from pathlib import Path
        >>> content = "PSB 1  1 3  stones 0 3  bennu_like bennu_like_low stone_degree8"
        >>> written = Path("stones.cla").write_text(content)
        >>> classification = fsh.read_classification("stones.cla")
        >>> classification.classes[0].full_name, classification.models
        ('stones', ('bennu_like', 'bennu_like_low', 'stone_degree8'))
    """
    file = Path(path)
    with open_regular(file) as stream:
        data = stream.read(_LARGEST_FILE + 1)
    if len(data) > _LARGEST_FILE:
        raise ValueError(f"{file}: is larger than {_LARGEST_FILE >> 20} MiB, so it is no classification file")
    try:
        return _parse(_Words(data.decode("utf-8-sig")))
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{file}: line {line}: not UTF-8 text, so it is no classification file") from None
    except _MalformedError as error:
        raise ValueError(f"{file}: {error}") from None


class _MalformedError(Exception):
    """What is wrong, with the line."""


class _Words:
    """The words of a text one after the other, and the line of the last one."""

    def __init__(self, text: str) -> None:
        self._words: Iterator[tuple[int, str]] = (
            (number, word) for number, line in enumerate(text.splitlines(), start=1) for word in line.split()
        )
        self._line = 1

    def next(self, wanted: str) -> str:
        """The next word; at the end of the text an error that says what was ``wanted``."""
        word = self.next_or_none()
        if word is None:
            raise self.error(f"the file ends where {wanted} should follow")
        return word

    def next_or_none(self) -> str | None:
        """The next word, or None at the end of the text."""
        self._line, word = next(self._words, (self._line, None))
        return word

    def count(self, wanted: str) -> int:
        """The next word as a number of things."""
        word = self.next(wanted)
        if not (word.isascii() and word.isdigit() and len(word) <= 9):
            raise self.error(f"{wanted} should follow, got {word[:80]!r}")
        return int(word)

    def error(self, reason: str) -> _MalformedError:
        """The error for the last word."""
        return _MalformedError(f"line {self._line}: {reason}")


def _parse(words: _Words) -> Classification:
    if words.next_or_none() != "PSB" or words.next_or_none() != "1":
        raise words.error("a classification file starts with 'PSB 1'")
    class_count = words.count("the number of classes")
    model_count = words.count("the number of models")
    paths: dict[str, tuple[str, ...]] = {_ROOT: ()}
    owner: dict[str, str] = {}
    classes: list[ShapeClass] = []
    for number in range(1, class_count + 1):
        name = words.next(f"class {number} of {class_count}")
        if name in paths:
            raise words.error(f"the class {name[:80]!r} appears a second time")
        parent = words.next(f"the parent of class {name[:80]!r}")
        if parent not in paths:
            raise words.error(f"the parent {parent[:80]!r} of class {name[:80]!r} is no class named before")
        size = words.count(f"the number of models of class {name[:80]!r}")
        models = []
        for position in range(1, size + 1):
            model = words.next(f"model {position} of {size} of class {name[:80]!r}")
            if model in owner:
                raise words.error(f"model {model[:80]!r} belongs to class {owner[model][:80]!r} already")
            owner[model] = name
            models.append(model)
        classes.append(ShapeClass(name, paths[parent], tuple(models)))
        paths[name] = (*paths[parent], name)
    extra = words.next_or_none()
    if extra is not None:
        raise words.error(f"{extra[:80]!r} follows the last of {class_count} classes")
    if len(owner) != model_count:
        raise words.error(f"the classes hold {len(owner)} models, but the second line announces {model_count}")
    return Classification(tuple(classes))
