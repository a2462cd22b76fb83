"""Assembly steps, joints and curve of a decomposition, from its report (decomposition.json). Pure."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, ValidationError


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class Joint(_Record):
    """Contact of two parts."""

    a: str
    b: str
    area_mm2: float
    glued: bool = True  # enough glue to hold by itself


class Step(_Record):
    """Step of the assembly: a body is glued to another one.

    Attributes
    ----------
    moved, fixed
        Parts of the body that is moved, and of the other one.
    slides
        Whether glued faces slide along each other.
    rests_on
        Parts on which the other body stands; none if it is held.
    level
        Steps of one level may be done side by side.
    """

    number: int
    moved: tuple[str, ...]
    fixed: tuple[str, ...]
    slides: bool = False
    rests_on: tuple[str, ...] = ()
    level: int = 1


class Assembly(_Record):
    """Steps in order, and groups of parts that cannot be taken apart in any order."""

    steps: tuple[Step, ...] = ()
    locked: tuple[tuple[str, ...], ...] = ()


class CurvePoint(_Record):
    """Expected parallel printing time with a number of printers."""

    printers: int
    makespan_s: float


class Report(_Record):
    """Joints, assembly and curve of a decomposition; what an earlier version did not write is empty."""

    joints: tuple[Joint, ...] = ()
    assembly: Assembly = Assembly()
    curve: tuple[CurvePoint, ...] = ()


def parse_report(text: bytes) -> Report:
    """Parse the report of a decomposition; an empty one if it is not valid."""
    try:
        return Report.model_validate_json(text)
    except ValidationError:
        return Report()
