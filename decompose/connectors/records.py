"""Records of connectors: pins, marks, gutters, and the tools that cut their holes and grooves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from decompose.arrays import Floats

RIM_MM = 1.2  # minimum wall around a tool: its distance from the outside of its part, and from another tool
KEY_RIM_MM = 0.8  # minimum wall around a key's groove: the width of two printed lines
SLIDING_COS = 0.999  # minimum absolute cosine between a key that slides and the direction of its step


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """A convex body that is cut out of a part.

    Attributes
    ----------
    part
        Number of the part.
    points_mm
        (n, 3) corners in the frame of the parts. The tool extends slightly beyond the face in which it opens;
        this opening is its mouth.
    inward_normal
        (3,) unit vector from that face into the part.
    face_offset_mm
        Coordinate of that face along `inward_normal`.
    exit_direction
        (3,) unit vector along which a groove also leaves its part, through another face that is glued; None
        for a tool that opens in one face only.
    """

    part: int
    points_mm: Floats
    inward_normal: Floats
    face_offset_mm: float
    exit_direction: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Pin:
    """A loose pin, which sits in holes of two parts, or lies in grooves of both as a key.

    Attributes
    ----------
    step, joint
        Number of the assembly step that closes the joint, and number of the joint.
    position_mm
        (3,) point on the axis of the pin, in the plane of the joint.
    axis
        (3,) unit vector, the direction of the step.
    diameter_mm
        Diameter of the pin itself; its holes are wider by their clearance.
    depth_mm
        Depth of the pin's hole in each part.
    length_mm
        Length to which the pin is cut; it is shorter than its two holes together.
    is_slotted
        Whether one hole is elongated along the line to the other pin of the pair (`find_pairs`), because the
        parts may shrink.
    holes
        Holes, or grooves, in the moved part and in the fixed one.
    key_direction
        (3,) unit vector along which a key lies; None for a pin in holes. If it is parallel to the step,
        the faces slide over each other, and one of the grooves has an exit through which the key enters.
    """

    step: int
    joint: int
    position_mm: Floats
    axis: Floats
    diameter_mm: float
    depth_mm: float
    length_mm: float
    is_slotted: bool
    holes: tuple[Tool, Tool]
    key_direction: Floats | None = None

    @property
    def rod_axis(self) -> Floats:
        """Unit vector (3,) along the length of the pin or key."""
        return self.axis if self.key_direction is None else self.key_direction

    @property
    def slides(self) -> bool:
        """True if the pin is a key that enters its groove lengthwise, while faces slide over each other."""
        return self.key_direction is not None and abs(float(self.key_direction @ self.axis)) > SLIDING_COS


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A text in V grooves on a face that is glued.

    Attributes
    ----------
    part, joint
        Number of the part that has the mark, and number of the joint.
    text
        Number of the neighbour after a hyphen (`-14`). If there is space, `^` follows: an arrow to the top of
        the model, or, on faces that are horizontal in the model, to its back. On one face of each part, the
        part's own number comes first (`10-14`), or stands alone (`10`). If no digits fit, the text consists
        of full stops, which are printed as dots; both faces of the joint have the same number of them.
    height_mm
        Height of the letters.
    lines_mm
        (k, 2, 3) ends of the strokes on the face.
    grooves
        Tools of the strokes.
    """

    part: int
    joint: int
    text: str
    height_mm: float
    lines_mm: Floats
    grooves: tuple[Tool, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Gutter:
    """An upright V groove on a face that is glued, which hides the seam of the outer wall.

    Attributes
    ----------
    part, joint
        Number of the part that has the gutter, and number of the joint.
    line_mm
        (2, 3) ends on the face, in the frame of the parts; the first is the lower end in the part's pose.
    groove
        Tool of the groove.
    """

    part: int
    joint: int
    line_mm: Floats
    groove: Tool


Connector = Pin | Mark | Gutter


@dataclass(frozen=True, slots=True)
class Connectors:
    """Pins, marks and gutters of all parts.

    Attributes
    ----------
    pins, marks
        Pins in the order of the steps, and marks in the order of the joints.
    unpinned_steps
        Steps without a pin, with the reason.
    unmarked_joints
        Joints without a mark on one of their faces, with the reason.
    gutters
        Gutters in the order of the parts.
    failures
        Sentences on connectors that were left out because they violated a rule.
    """

    pins: tuple[Pin, ...] = ()
    marks: tuple[Mark, ...] = ()
    unpinned_steps: tuple[tuple[int, str], ...] = ()
    unmarked_joints: tuple[tuple[int, str], ...] = ()
    failures: tuple[str, ...] = ()
    gutters: tuple[Gutter, ...] = ()

    @property
    def tools(self) -> list[Tool]:
        """Tools of all pins, marks and gutters."""
        return [
            *(hole for pin in self.pins for hole in pin.holes),
            *(groove for mark in self.marks for groove in mark.grooves),
            *(gutter.groove for gutter in self.gutters),
        ]

    @property
    def members(self) -> tuple[Connector, ...]:
        """All pins, marks and gutters."""
        return (*self.pins, *self.marks, *self.gutters)

    def remove(self, connector: Connector, reason: str) -> Connectors:
        """Remove a connector, and add the reason to the failures.

        If it is a pin of a pair (`find_pairs`), only the other pin of the pair stays at the step, apart from
        keys that slide: further pins all have one shape, so that the body would also fit if it is turned.
        """
        removed = {connector}
        if isinstance(connector, Pin):
            step, pair = connector.step, find_pairs(self.pins).get(connector.step, ())
            if connector in pair:
                removed.update(p for p in self.pins if p.step == step and not p.slides and p not in pair)
        return replace(
            self,
            pins=tuple(pin for pin in self.pins if pin not in removed),
            marks=tuple(mark for mark in self.marks if mark not in removed),
            gutters=tuple(gutter for gutter in self.gutters if gutter not in removed),
            failures=(*self.failures, reason),
        )

    def remove_from_part(self, part: int, reason: str) -> Connectors:
        """Remove the connectors that cut a part, and add the reason to the failures."""
        return replace(
            self,
            pins=tuple(pin for pin in self.pins if all(hole.part != part for hole in pin.holes)),
            marks=tuple(mark for mark in self.marks if mark.part != part),
            gutters=tuple(gutter for gutter in self.gutters if gutter.part != part),
            failures=(*self.failures, reason),
        )


def find_pairs(pins: Sequence[Pin]) -> dict[int, tuple[Pin, Pin]]:
    """Find the pair of each step that has one: its first two pins, unless both have the same shape.

    Keys that slide belong to no pair, because their long grooves fit any key.
    """
    pins_by_step: dict[int, list[Pin]] = {}
    for pin in (pin for pin in pins if not pin.slides):
        pins_by_step.setdefault(pin.step, []).append(pin)
    return {
        step: (step_pins[0], step_pins[1])
        for step, step_pins in pins_by_step.items()
        if len(step_pins) > 1 and _describe_shape(step_pins[0]) != _describe_shape(step_pins[1])
    }


def _describe_shape(pin: Pin) -> tuple[float, bool]:
    """Describe a pin by its length and type; a thinner key fits any groove of its length."""
    return pin.length_mm, pin.key_direction is None
