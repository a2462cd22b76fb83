"""One model part of a 3MF package: its objects and build items, read as a stream.

Source: 3MF core specification 1.3, chapters 3 to 5; production extension 1.1.2 for paths.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.errors import ModelTooDetailed, ModelUnreadable
from decompose.geometry.formats.threemf.package import make_parser, parse_chunks

MAX_OTHER_TAGS = 1_000_000  # maximum number of tags of other kinds, such as colours
MM_PER_UNIT = {
    "micron": 0.001,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}

_SCHEMA = "http://schemas.microsoft.com/3dmanufacturing/"
_CORE_NAMESPACES = (f"{_SCHEMA}core/2015/02", f"{_SCHEMA}2013/01/3dmodel")
_PRODUCTION_NAMESPACE = f"{_SCHEMA}production/2015/06"
_SUPPORTED_EXTENSIONS = (
    _PRODUCTION_NAMESPACE,
    f"{_SCHEMA}material/2015/02",
    f"{_SCHEMA}trianglesets/2021/07",
)
"""The production extension, which is read, and extensions without effect on the shape."""
_IDENTITY_TRANSFORM = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference to an object, which the build or another object places.

    Attributes
    ----------
    object_id
        Number of the object in its part.
    transform
        (4, 3) matrix: a point (x, y, z, 1) times this matrix is the placed point.
    path
        Path of the object's part; empty if that is the part with the reference.
    """

    object_id: str
    transform: Floats
    path: str = ""


@dataclass(slots=True)
class ObjectRecord:
    """An object of a model part: it has a mesh, or components that refer to other objects."""

    kind: str
    vertices: array[float] = field(default_factory=lambda: array("d"))
    faces: array[int] = field(default_factory=lambda: array("q"))
    components: list[Reference] = field(default_factory=list)

    @property
    def face_count(self) -> int:
        """Number of triangles."""
        return len(self.faces) // 3

    def build_triangles(self) -> Floats:
        """Build the triangles (m, 3, 3) of the mesh; raise IndexError if a corner does not exist."""
        vertices = np.frombuffer(self.vertices, dtype=np.float64).reshape(-1, 3)
        faces: Ints = np.frombuffer(self.faces, dtype=np.int64).reshape(-1, 3)
        if faces.size and faces.min() < 0:
            raise IndexError("negative")
        return np.asarray(vertices[faces])


@dataclass(slots=True)
class ModelPart:
    """Content of a model part; `unit` is None if the part states none."""

    unit: str | None = None
    objects: dict[str, ObjectRecord] = field(default_factory=dict)
    items: list[Reference] = field(default_factory=list)
    unprinted_item_count: int = 0


def read_model_part(name: str, part: str, chunks: Iterator[bytes], max_triangles: int) -> ModelPart:
    """Read a model part.

    Parameters
    ----------
    name, part
        Names of the file and of the part, for messages.
    chunks
        Bytes of the part.
    max_triangles
        Maximum number of triangles; a part may have three times as many vertices.

    Raises
    ------
    ModelUnreadable
        The part is not a model, is damaged, or needs an extension that is not read.
    ModelTooDetailed
        The part has too many triangles or vertices.
    """
    handler = _TagHandler(name, max_triangles)
    parser = make_parser(name)
    parser.StartElementHandler = handler.begin_tag
    parser.EndElementHandler = handler.end_tag
    parser.StartNamespaceDeclHandler = handler.declare_namespace
    try:
        parse_chunks(parser, name, part, chunks)
    except (KeyError, ValueError, OverflowError) as error:
        problem = f"has no {error}" if isinstance(error, KeyError) else str(error)
        raise ModelUnreadable(
            f"{name}: line {parser.CurrentLineNumber} of its model: {problem[:80]}; export it again"
        ) from error
    if not handler.is_model:
        raise ModelUnreadable(f"{name}: its part {part[:80]} is not a 3MF model; export it again")
    return handler.part


class _TagHandler:
    """Handler of the tags of a model part."""

    def __init__(self, name: str, max_triangles: int) -> None:
        self.part = ModelPart()
        self.is_model = False
        self._name, self._max_triangles = name, max_triangles
        self._namespaces: dict[str, str] = {}
        self._object = ObjectRecord("")
        self._is_in_object = False
        self._other_tags = self._triangles = 0
        self._handlers = {
            f"{core} {tag}": handler
            for core in _CORE_NAMESPACES
            for tag, handler in (
                ("vertex", self._add_vertex),
                ("triangle", self._add_triangle),
                ("object", self._begin_object),
                ("component", self._add_component),
                ("item", self._add_item),
                ("model", self._begin_model),
            )
        }
        self._object_tags = {f"{core} object" for core in _CORE_NAMESPACES}

    def declare_namespace(self, prefix: str | None, uri: str) -> None:
        """Record the URI of a namespace."""
        self._namespaces[prefix or ""] = uri

    def begin_tag(self, tag: str, attributes: dict[str, str]) -> None:
        """Handle the start of a tag; count tags of other kinds."""
        handler = self._handlers.get(tag)
        if handler is not None:
            handler(attributes)
            return
        self._other_tags += 1
        if self._other_tags > MAX_OTHER_TAGS:
            raise ModelUnreadable(
                f"{self._name}: has over {MAX_OTHER_TAGS} tags besides its mesh; export it without colours"
            )

    def end_tag(self, tag: str) -> None:
        """Handle the end of a tag."""
        if tag in self._object_tags:
            self._is_in_object = False

    def _begin_model(self, attributes: Mapping[str, str]) -> None:
        """Record the unit of the model; refuse a model that needs an extension that is not supported."""
        self.is_model = True
        self.part.unit = attributes.get("unit")
        for prefix in attributes.get("requiredextensions", "").split():
            uri = self._namespaces.get(prefix, prefix)
            if uri not in _SUPPORTED_EXTENSIONS:
                raise ModelUnreadable(
                    f"{self._name}: needs the 3MF extension {uri.removeprefix(_SCHEMA)[:60]}, which is not "
                    "read; export it as plain triangles, or as STL"
                )

    def _begin_object(self, attributes: Mapping[str, str]) -> None:
        """Add an object, to which the next vertices, triangles and components belong."""
        self._object = ObjectRecord(attributes.get("type", "model"))
        self._is_in_object = True
        number = attributes["id"]
        if number in self.part.objects:
            raise ValueError(f"repeats the object {number[:20]}")
        self.part.objects[number] = self._object

    def _add_vertex(self, attributes: Mapping[str, str]) -> None:
        """Add a vertex to the object."""
        vertices = self._object.vertices
        vertices.append(float(attributes["x"]))
        vertices.append(float(attributes["y"]))
        vertices.append(float(attributes["z"]))
        if len(vertices) > 9 * self._max_triangles:
            self._raise_too_detailed()

    def _add_triangle(self, attributes: Mapping[str, str]) -> None:
        """Add a triangle to the object."""
        faces = self._object.faces
        faces.append(int(attributes["v1"]))
        faces.append(int(attributes["v2"]))
        faces.append(int(attributes["v3"]))
        self._triangles += 1
        if self._triangles > self._max_triangles:
            self._raise_too_detailed()

    def _raise_too_detailed(self) -> None:
        """Raise the error of a part with too many triangles."""
        raise ModelTooDetailed(
            f"{self._name}: has more than {self._max_triangles / 1e6:.1f} million triangles, for which the "
            "memory is too small: simplify its mesh"
        )

    def _add_component(self, attributes: Mapping[str, str]) -> None:
        """Add a component to the object."""
        if self._is_in_object:
            self._object.components.append(_read_reference(attributes))

    def _add_item(self, attributes: Mapping[str, str]) -> None:
        """Add a build item, or count it if it is not to be printed."""
        if attributes.get("printable", "1") in ("0", "false"):  # written by slicers
            self.part.unprinted_item_count += 1
        else:
            self.part.items.append(_read_reference(attributes))


def _read_reference(attributes: Mapping[str, str]) -> Reference:
    """Read the reference of a component or a build item."""
    text = attributes.get("transform")
    numbers = _IDENTITY_TRANSFORM if text is None else tuple(map(float, text.split()))
    if len(numbers) != 12 or not all(map(math.isfinite, numbers)):
        raise ValueError("has a transform that is not 12 numbers")
    path = attributes.get(f"{_PRODUCTION_NAMESPACE} path", "")
    return Reference(attributes["objectid"], np.array(numbers).reshape(4, 3), path)
