"""Triangles of a 3MF file, placed as its build section states."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from decompose.arrays import Floats
from decompose.errors import ModelEmpty, ModelTooDetailed, ModelUnreadable
from decompose.geometry.formats.threemf.model_part import (
    MM_PER_UNIT,
    ModelPart,
    ObjectRecord,
    Reference,
    read_model_part,
)
from decompose.geometry.formats.threemf.package import Package, resolve_path

MAX_DEPTH = 64  # maximum depth of nested components
MAX_INSTANCES = 10_000
MAX_TRIANGLES = 20_000_000  # maximum number of triangles if no memory limit is given

_SOLID_TYPE = "model"  # the only type of object that is printed; others are supports and surfaces


def read_3mf(name: str, data: bytes, max_triangles: int | None = None) -> tuple[Floats, tuple[str, ...]]:
    """Read the objects that the build of a 3MF file places.

    Parameters
    ----------
    name
        Name of the file, for messages.
    data
        Content of the file.
    max_triangles
        Number of triangles that fit in memory; None for `MAX_TRIANGLES`.

    Returns
    -------
    triangles, notes
        (m, 3, 3) in mm, and sentences on what was read and left out.

    Raises
    ------
    ModelUnreadable
        The file is damaged, or needs an extension that is not read.
    ModelEmpty
        The build places no triangles.
    ModelTooDetailed
        There are more triangles than fit in memory, or too many objects.
    """
    package = Package(name, data)
    build = _Build(name, package, max_triangles or MAX_TRIANGLES)
    root = resolve_path(package.find_model())
    part = build.find_part(root)
    if not part.items:
        raise ModelEmpty(f"{name}: its build places no object; place one and export it again")
    unit = build.unit
    size = build.measure_references(root, part.items)
    if size.triangle_count > build.max_triangles:
        raise ModelTooDetailed(
            f"{name}: has {size.triangle_count / 1e6:.1f} million triangles, but the memory suffices only "
            f"for {build.max_triangles / 1e6:.1f} million: simplify its mesh"
        )
    if size.instance_count > MAX_INSTANCES:
        raise ModelTooDetailed(f"{name}: places more than {MAX_INSTANCES} objects; export fewer")
    if not size.triangle_count:
        raise ModelEmpty(f"{name}: its build places no triangles; export the model again")
    with np.errstate(over="ignore", invalid="ignore"):  # checked by the caller
        placed_triangles = list(build.place_references(root, part.items, np.vstack((np.eye(3), np.zeros(3)))))
        triangles = np.concatenate(placed_triangles) * MM_PER_UNIT[unit]
    return triangles, tuple(_list_notes(build, part, len(placed_triangles), unit))


def _list_notes(build: _Build, root: ModelPart, instance_count: int, unit: str) -> Iterator[str]:
    """Yield sentences on what was read and left out."""
    if instance_count > 1:
        yield f"Read {instance_count} objects as one model, placed as in the file."
    if unit != "millimeter":
        yield f"Converted from the unit {unit}."
    if root.unprinted_item_count:
        yield f"Left out objects that are marked as not to be printed: {root.unprinted_item_count}."
    if build.other_kinds:
        yield f"Left out objects of the type {', '.join(sorted(build.other_kinds))}."
    unplaced_count = build.count_unplaced_objects()
    if unplaced_count:
        yield f"Left out objects that the build of the file does not place: {unplaced_count}."
    if build.package.has_modifiers():
        yield (
            "Warning: a slicer marked some volumes as modifiers, as negative or as supports; they are "
            "read as solid: remove them, or export STL."
        )


@dataclass(frozen=True, slots=True)
class _Size:
    """Number of triangles of an object with all its components, and number of meshes that they place."""

    triangle_count: int = 0
    instance_count: int = 0


@dataclass(slots=True)
class _Build:
    """Objects of all parts of a package, read on first use."""

    name: str
    package: Package
    max_triangles: int
    unit: str = ""
    other_kinds: set[str] = field(default_factory=set)
    _parts: dict[str, ModelPart] = field(default_factory=dict)
    _sizes: dict[tuple[str, str], _Size | None] = field(default_factory=dict)  # None while it is measured

    def find_part(self, path: str) -> ModelPart:
        """Find a model part, and read it on first use; all parts must have the same unit."""
        if path not in self._parts:
            part = read_model_part(self.name, path, self.package.unpack(path), self.max_triangles)
            unit = part.unit or self.unit or "millimeter"
            if unit not in MM_PER_UNIT or (self.unit and unit != self.unit):
                raise ModelUnreadable(
                    f"{self.name}: its unit {unit[:20]} is not known, or not the same in all parts; "
                    "export it in millimetres"
                )
            self.unit = unit
            self._parts[path] = part
        return self._parts[path]

    def measure_references(self, path: str, references: list[Reference], depth: int = 0) -> _Size:
        """Count the objects and triangles that references place, before any of them is placed."""
        if depth > MAX_DEPTH:
            raise ModelUnreadable(f"{self.name}: nests objects more than {MAX_DEPTH} deep; export it again")
        sizes = [self._measure_object(*self._find_object(path, reference), depth) for reference in references]
        return _Size(sum(size.triangle_count for size in sizes), sum(size.instance_count for size in sizes))

    def _measure_object(self, key: tuple[str, str], record: ObjectRecord, depth: int) -> _Size:
        """Count the meshes and triangles of an object; refuse one that contains itself."""
        if key in self._sizes:
            size = self._sizes[key]
            if size is None:
                raise ModelUnreadable(
                    f"{self.name}: its object {key[1][:20]} contains itself; export it again"
                )
            return size
        self._sizes[key] = None
        if record.kind != _SOLID_TYPE:
            self.other_kinds.add(record.kind[:20])
            size = _Size()
        else:
            component_size = self.measure_references(key[0], record.components, depth + 1)
            own_meshes = 1 if record.face_count else 0
            size = _Size(
                component_size.triangle_count + record.face_count, component_size.instance_count + own_meshes
            )
        self._sizes[key] = size
        return size

    def _find_object(self, path: str, reference: Reference) -> tuple[tuple[str, str], ObjectRecord]:
        """Find the object of a reference in a part, and its key among all objects."""
        target = resolve_path(reference.path) if reference.path else path
        record = self.find_part(target).objects.get(reference.object_id)
        if record is None:
            raise ModelUnreadable(
                f"{self.name}: its object {reference.object_id[:20]} is missing; export it again"
            )
        return (target, reference.object_id), record

    def place_references(
        self, path: str, references: list[Reference], parent_transform: Floats
    ) -> Iterator[Floats]:
        """Yield the triangles (m, 3, 3) of each mesh that references place, in the unit of the file.

        Parameters
        ----------
        path
            Path of the package part that contains the references.
        references
            References to place.
        parent_transform
            (4, 3) transform of the object that they belong to.
        """
        for reference in references:
            key, record = self._find_object(path, reference)
            if not (self._sizes[key] or _Size()).triangle_count:
                continue
            own_transform = reference.transform
            transform = np.vstack(
                (
                    own_transform[:3] @ parent_transform[:3],
                    own_transform[3] @ parent_transform[:3] + parent_transform[3],
                )
            )
            if record.face_count:
                yield self._transform_mesh(record, transform)
            yield from self.place_references(key[0], record.components, transform)

    def _transform_mesh(self, record: ObjectRecord, transform: Floats) -> Floats:
        """Transform the triangles (m, 3, 3) of an object."""
        try:
            triangles = record.build_triangles()
        except IndexError:
            raise ModelUnreadable(
                f"{self.name}: a triangle has a corner that is not in its list; export it again"
            ) from None
        triangles = triangles @ transform[:3] + transform[3]
        is_mirrored = np.linalg.det(transform[:3]) < 0  # the triangles would face inwards
        return np.asarray(triangles[:, ::-1] if is_mirrored else triangles)

    def count_unplaced_objects(self) -> int:
        """Count the solid objects with a mesh that are not placed."""
        return sum(
            record.kind == _SOLID_TYPE and record.face_count > 0 and (path, number) not in self._sizes
            for path, part in self._parts.items()
            for number, record in part.objects.items()
        )
