"""Fragments of a page, and the changes between two renderings. Pure.

A fragment is an element that changes independently of the rest. A template marks it with comments:
`<!--live:ID-->` before the element, with the element's id, and `<!--/live-->` after it. Fragments are not
nested. If something outside the fragments changes, the whole main element of the page is sent.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass

MAIN_ID = "main"
"""Id of the element that contains all fragments."""
_FRAGMENT_PATTERN = re.compile(r"<!--live:([^>]*?)-->\s*(.*?)\s*<!--/live-->", re.DOTALL)
_MAIN_PATTERN = re.compile(r'<main id="main">.*</main>', re.DOTALL)
_VERSION_ATTRIBUTE = 'data-version=""'


@dataclass(frozen=True, slots=True)
class Fragments:
    """Content of a page's main element.

    Attributes
    ----------
    frame
        The main element, with only the comments in place of each fragment.
    elements
        HTML of each fragment by its id.
    """

    frame: str
    elements: Mapping[str, str]

    @property
    def html(self) -> str:
        """The whole main element."""
        return _FRAGMENT_PATTERN.sub(lambda match: self.elements[match[1]], self.frame)

    @property
    def version(self) -> str:
        """Short hash of the content, by which a browser states the version that it shows."""
        return hashlib.blake2b(self.html.encode(), digest_size=9).hexdigest()


def split_page(page: str) -> Fragments:
    """Split the main element of a rendered page into its fragments."""
    match = _MAIN_PATTERN.search(page)
    main = "" if match is None else match[0]
    elements = {fragment[1]: fragment[2] for fragment in _FRAGMENT_PATTERN.finditer(main)}
    return Fragments(_FRAGMENT_PATTERN.sub(r"<!--live:\1--><!--/live-->", main), elements)


def prepare_page(page: str) -> str:
    """Prepare a rendered page for a browser: remove the comments of the fragments, and add the version."""
    if _VERSION_ATTRIBUTE not in page:
        return page
    fragments = split_page(page)
    head, _, tail = page.partition('<main id="main">')
    head = head.replace(_VERSION_ATTRIBUTE, f'data-version="{fragments.version}"', 1)
    return head + fragments.html + tail.rpartition("</main>")[2]


def find_changes(old_fragments: Fragments, new_fragments: Fragments) -> dict[str, str]:
    """Return the HTML of the changed fragments by id.

    The whole main element is returned instead if fragments were added, removed or moved, or if anything
    outside them has changed.
    """
    if old_fragments.frame != new_fragments.frame:
        return {MAIN_ID: new_fragments.html}
    return {
        name: html for name, html in new_fragments.elements.items() if old_fragments.elements[name] != html
    }
