"""Assembly steps, joints and time curve of a decomposition, from its report (decomposition.json). Pure."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, ValidationError


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Joint(_Record):
    """Contact of the parts `a` and `b`."""

    a: str
    b: str
    area_mm2: float
    glued: bool = True  # True if the glued area of this joint suffices without other joints


class MarkText(_Record):
    """Text of the mark on a glued face of a part."""

    part: str
    text: str


class Pin(_Record):
    """Pin in the holes of two parts, or key in their grooves."""

    id: int
    length_mm: float
    diameter_mm: float = 0.0
    kind: str = "round"

    @property
    def size(self) -> str:
        """Length in mm as text; for a key, length × diameter in mm."""
        length = f"{round(self.length_mm, 1):g}"
        return f"{length} × {self.diameter_mm:g}" if self.kind == "key" else length


class Step(_Record):
    """Step of the assembly, in which a body of glued parts is moved and glued to another body.

    Attributes
    ----------
    moved, fixed
        Parts of the body that is moved, and of the body that stays in place.
    slides
        True if glued faces slide along each other.
    rests_on
        Parts on which the fixed body stands; none if a person holds it.
    level
        Level in the assembly; steps of the same level may be done in parallel.
    seam_mm
        Length of the step's seams on the outer surface.
    pins
        Ids of the pins and keys in the joints of the step.
    codes
        Texts of the marks on the faces that are glued in the step.
    """

    number: int
    moved: tuple[str, ...]
    fixed: tuple[str, ...]
    slides: bool = False
    rests_on: tuple[str, ...] = ()
    level: int = 1
    seam_mm: float = 0.0
    pins: tuple[int, ...] = ()
    codes: tuple[MarkText, ...] = ()


class Assembly(_Record):
    """Steps of the assembly in order, and groups of interlocked parts, for which no order is known."""

    steps: tuple[Step, ...] = ()
    locked: tuple[tuple[str, ...], ...] = ()


class Connectors(_Record):
    """Pins and keys of all steps."""

    pins: tuple[Pin, ...] = ()


class CurvePoint(_Record):
    """Expected parallel printing time with a number of printers."""

    printers: int
    makespan_s: float


class Report(_Record):
    """Joints, assembly and time curve of a decomposition; fields missing in old reports are empty.

    Attributes
    ----------
    seam_mm
        Length of all seams on the outer surface.
    thin_rims
        Sentence about rims at seams that are thinner than two printed walls; empty if there are none.
    """

    joints: tuple[Joint, ...] = ()
    assembly: Assembly = Assembly()
    connectors: Connectors = Connectors()
    curve: tuple[CurvePoint, ...] = ()
    seam_mm: float = 0.0
    thin_rims: str = ""

    def list_pins(self, step: Step) -> list[Pin]:
        """List the pins and keys of a step."""
        pins = {pin.id: pin for pin in self.connectors.pins}
        return [pins[number] for number in step.pins if number in pins]


def parse_report(text: bytes) -> Report:
    """Parse the report of a decomposition; return an empty report if the text is invalid."""
    try:
        return Report.model_validate_json(text)
    except ValidationError:
        return Report()
