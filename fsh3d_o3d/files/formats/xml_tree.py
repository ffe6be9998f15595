"""XML into a tree, by Python's own Expat: no entity is defined by a file, and none is fetched."""

from __future__ import annotations

from collections.abc import Iterator
from xml.parsers import expat

from fsh3d_o3d.errors import GeometryReadError

_DEEPEST = 200  # elements one in another, a choice: scenes have some ten, and walking a tree goes as deep
_BUFFER = 1 << 20  # bytes of text that come in one piece, a choice


class XmlElement:
    """An element; names come without their namespaces."""

    __slots__ = ("attributes", "children", "name", "pieces")

    def __init__(self, name: str, attributes: dict[str, str]) -> None:
        self.name = name
        self.attributes = attributes
        self.children: list[XmlElement] = []
        self.pieces: list[str] = []

    @property
    def text(self) -> str:
        """The text between its marks, without that of its children."""
        return "".join(self.pieces)

    def find(self, name: str) -> XmlElement | None:
        """Return the first child of a name."""
        return next((child for child in self.children if child.name == name), None)

    def all(self, name: str) -> Iterator[XmlElement]:
        """Yield the children of a name."""
        return (child for child in self.children if child.name == name)

    def below(self) -> Iterator[XmlElement]:
        """Yield the element and all below it, each before its children."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack += element.children[::-1]


def xml_root(data: bytes, what: str = "the file") -> XmlElement:
    """Return the outermost element of a document in UTF-8, whatever encoding it names.

    Raises:
        GeometryReadError: It is no well-formed XML, breaks off, nests too deeply, or defines entities.
    """
    top = XmlElement("", {})
    stack = [top]

    def begin(name: str, attributes: dict[str, str]) -> None:
        if len(stack) > _DEEPEST:
            raise GeometryReadError(f"damaged: elements of {what} are nested more than {_DEEPEST} deep")
        plain = {key.rpartition(":")[2] if key[:5] != "xmlns" else key: value for key, value in attributes.items()}
        element = XmlElement(name.rpartition(":")[2], plain)
        stack[-1].children.append(element)
        stack.append(element)

    def refuse(*_: object) -> None:
        raise GeometryReadError(f"{what} defines entities of its own, which are not read")

    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.buffer_size = _BUFFER
    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda name: stack.pop()
    parser.CharacterDataHandler = lambda text: stack[-1].pieces.append(text)
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise GeometryReadError(f"truncated or damaged: {what} is no whole XML ({error})") from None
    return top.children[0]
