"""Placement, cutting and checks of the pins and marks of a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from decompose.connectors import Blank, Connectors, Pin, drill_parts, plan_connectors
from decompose.errors import DecomposeError
from decompose.files.names import find_part_number
from decompose.geometry import Solid
from decompose.results.connector_prices import price_connectors
from decompose.results.connector_rules import ConnectorFault, DrilledParts
from decompose.results.decomposition import Decomposition, Part
from decompose.results.hidden_sides import list_hidden_grooves, list_hidden_recesses


def connect_parts(decomposition: Decomposition) -> Decomposition:
    """Cut holes for pins, and marks, into the parts of a result whose assembly is planned.

    A connector that would break a rule is left out. If no single one is to blame, the part gets none; if pins
    of several parts break a rule together, no part gets pins. The reasons are in `Connectors.failures`.

    Parameters
    ----------
    decomposition
        Decomposition that `Decomposition.with_assembly` returned.

    Returns
    -------
    Decomposition
        The decomposition with `Part.drilled_solid` and `connectors`, and with the price of these instead of
        an estimate; unchanged if the options request neither pins nor marks, or if there is only one part.
    """
    options = decomposition.options
    if options.connectors.is_empty or len(decomposition.parts) < 2:
        return decomposition
    blanks = [
        Blank(
            name=find_part_number(p.id),
            solid=p.solid,
            up_direction=p.rotation[2],
            pin_fit_mm=options.connectors.find_fit_mm(p.printer),
            right_direction=p.rotation[0],
        )
        for p in decomposition.parts
    ]
    try:
        connectors = plan_connectors(
            blanks, decomposition.joints, decomposition.assembly, options.connectors, options.min_glue_mm2
        )
        connectors, drilled_solids = _drill_without_faults(blanks, connectors, decomposition)
    except Exception as error:  # shapely and Qhull have errors of their own; parts need no connectors
        return omit_connectors(decomposition, str(error) or type(error).__name__)
    cut_parts = {tool.part for tool in connectors.tools}
    added_s = [price_connectors(connectors, i, blank.up_direction) for i, blank in enumerate(blanks)]
    key_grooves = [tool for pin in connectors.pins if pin.key_direction is not None for tool in pin.holes]
    recesses = [mark.grooves for mark in connectors.marks] + [(groove,) for groove in key_grooves]
    parts = tuple(
        replace(
            part,
            drilled_solid=solid,
            price_s=part.bare_price_s + added_s[i],
            connectors_s=added_s[i],
            hidden_grooves=list_hidden_grooves(part, [tool for tool in key_grooves if tool.part == i]),
            hidden_recesses=list_hidden_recesses(part, [r for r in recesses if r[0].part == i]),
        )
        if i in cut_parts
        else _omit_price(part)
        for i, (part, solid) in enumerate(zip(decomposition.parts, drilled_solids, strict=True))
    )
    return _replace_connectors(decomposition, connectors, parts)


def omit_connectors(decomposition: Decomposition, reason: str) -> Decomposition:
    """Return a decomposition without pins and marks and without their price, and with the reason."""
    connectors = Connectors(failures=(f"no pins and marks: {reason}",))
    return _replace_connectors(decomposition, connectors, tuple(map(_omit_price, decomposition.parts)))


def _replace_connectors(
    decomposition: Decomposition, connectors: Connectors, parts: tuple[Part, ...]
) -> Decomposition:
    """Replace the connectors and the parts, and compute the times of all parts together from their prices.

    The makespan stays if the speed of a printer is not known: loads may have been moved to printers for which
    the model was not cut.
    """
    makespan_s = decomposition.makespan_s
    printers = () if decomposition.cutting is None else decomposition.cutting.printers
    factors = {printer.name: printer.time_factor for printer in printers}
    if all(part.printer in factors for part in parts):
        makespan_s = max(part.price_s * factors[part.printer] for part in parts)
    sum_s = sum(part.price_s for part in parts)
    return replace(decomposition, connectors=connectors, parts=parts, makespan_s=makespan_s, sum_s=sum_s)


def _omit_price(part: Part) -> Part:
    """Return a part without the price of its connectors."""
    return replace(part, price_s=part.bare_price_s, connectors_s=0.0)


def _drill_without_faults(
    blanks: Sequence[Blank], connectors: Connectors, decomposition: Decomposition
) -> tuple[Connectors, list[Solid]]:
    """Drill the parts, and remove connectors until no rule is broken; return the rest and the drilled solids.

    Raises
    ------
    DecomposeError
        Rules are still broken after more attempts than there are connectors.
    """
    for _ in range(len(connectors.members) + 1):  # each attempt removes at least one
        drilled_solids = drill_parts(blanks, connectors)
        parts = DrilledParts(
            blanks,
            drilled_solids,
            decomposition.joints,
            decomposition.assembly.steps,
            connectors,
            decomposition.options.connectors.used_shapes,
        )
        faults = list(parts.find_faults())
        if not faults:
            return connectors, drilled_solids
        connectors = _remove_faulty_connectors(connectors, faults, decomposition)
    raise DecomposeError("the rules of pins and marks are broken repeatedly")


def _remove_faulty_connectors(
    connectors: Connectors, faults: list[ConnectorFault], decomposition: Decomposition
) -> Connectors:
    """Remove each faulty connector, or all of a faulty part; if a fault names no part, remove all pins."""
    for fault in faults:
        because = f"{fault.problem} (rule {fault.rule})"
        if fault.part is None:
            reason = f"no pins: {because}"
            connectors = replace(connectors, pins=(), failures=(*connectors.failures, reason))
            continue
        name = decomposition.parts[fault.part].id
        if fault.connector is None:
            connectors = connectors.remove_from_part(fault.part, f"{name} has no holes and marks: {because}")
        elif fault.connector in connectors.members:
            joint = decomposition.joints[fault.connector.joint]
            neighbour = decomposition.parts[joint.a + joint.b - fault.part].id
            is_key = isinstance(fault.connector, Pin) and fault.connector.key_direction is not None
            kind = "key" if is_key else type(fault.connector).__name__.lower()
            reason = f"a {kind} of {name} towards {neighbour} is left out: {because}"
            connectors = connectors.remove(fault.connector, reason)
    return replace(connectors, failures=tuple(dict.fromkeys(connectors.failures)))
