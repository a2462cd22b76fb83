"""Check of a page of instructions: whether it names all parts and joints, and loads no other files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser

from decompose.export.connector_rows import name_mark
from decompose.results import Decomposition

_LOADING_ATTRIBUTES = ("src", "href", "srcset", "poster", "action", "background")


class _Reader(HTMLParser):
    """Reader of the names in a page's `data-KIND` attributes, and of the addresses that the page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.name_counts: Counter[tuple[str, str]] = Counter()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Record the names and the addresses in the attributes of a tag."""
        if tag in ("script", "link", "iframe", "object", "embed"):
            self.addresses.append(f"<{tag}>")
        for name, value in attributes:
            if name.startswith("data-"):
                self.name_counts[name.removeprefix("data-"), value or ""] += 1
            elif name in _LOADING_ATTRIBUTES and not (value or "").startswith(("data:", "#")):
                self.addresses.append(value or "")


def find_page_faults(page: str, decomposition: Decomposition) -> list[str]:
    """Find names that are missing, repeated or unknown on a page of instructions, and files that it loads.

    Parameters
    ----------
    page
        HTML of the page.
    decomposition
        Decomposition that the page describes; the page need not name joints that no step glues.

    Returns
    -------
    list of str
        A phrase that describes each fault.
    """
    reader = _Reader()
    reader.feed(page)
    reader.close()
    expected_names = Counter(_list_expected_names(decomposition))
    faults = [f"{kind} {name} is missing" for kind, name in expected_names - reader.name_counts]
    faults += [f"{kind} {name} is named too often" for kind, name in reader.name_counts - expected_names]
    faults += [f"it loads {address[:80]}" for address in reader.addresses]
    if "url(" in page or "@import" in page:
        faults.append("its style loads a file")
    return faults


def _list_expected_names(decomposition: Decomposition) -> Iterator[tuple[str, str]]:
    """Yield the kind and the name of each part, pin, mark, step and joint that a page has to name."""
    names = [part.id for part in decomposition.parts]
    for name in names:
        yield "part", name
    for number, _ in enumerate(decomposition.connectors.pins, 1):
        yield "pin", str(number)
    for mark in decomposition.connectors.marks:
        yield "mark", f"{name_mark(decomposition, mark)} {mark.text}"
    for number, step in enumerate(decomposition.assembly.steps, 1):
        yield "step", str(number)
        for joint in (decomposition.joints[j] for j in step.joints):
            yield "joint", f"{names[joint.a]} {names[joint.b]}"
