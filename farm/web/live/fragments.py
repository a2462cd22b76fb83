"""Fragments of a page, and those that changed from one rendering to the next. Pure.

A template marks each element that may change by itself with comments: `<!--live:ID-->` before it, with its
id, and `<!--/live-->` behind it. Fragments do not contain each other; what is outside changes less often.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass

MAIN = "main"
"""Id of the element that has all fragments."""
_FRAGMENT = re.compile(r"<!--live:([^>]*?)-->\s*(.*?)\s*<!--/live-->", re.DOTALL)
_MAIN = re.compile(r'<main id="main">.*</main>', re.DOTALL)
_VERSION = 'data-version=""'


@dataclass(frozen=True, slots=True)
class Fragments:
    """Content of a page.

    Attributes
    ----------
    frame
        The main element, with a comment in place of each fragment.
    elements
        HTML of each fragment by its id.
    """

    frame: str
    elements: Mapping[str, str]

    @property
    def html(self) -> str:
        """The whole main element."""
        return _FRAGMENT.sub(lambda match: self.elements[match[1]], self.frame)

    @property
    def version(self) -> str:
        """Short hash of the content."""
        return hashlib.blake2b(self.html.encode(), digest_size=9).hexdigest()


def split_page(page: str) -> Fragments:
    """Split the main element of a rendered page into its fragments."""
    match = _MAIN.search(page)
    main = "" if match is None else match[0]
    elements = {mark[1]: mark[2] for mark in _FRAGMENT.finditer(main)}
    return Fragments(_FRAGMENT.sub(r"<!--live:\1--><!--/live-->", main), elements)


def publish_page(page: str) -> str:
    """Return a rendered page as it is sent: without marks, with the version of its content."""
    if _VERSION not in page:
        return page
    fragments = split_page(page)
    head, _, tail = page.partition('<main id="main">')
    head = head.replace(_VERSION, f'data-version="{fragments.version}"', 1)
    return head + fragments.html + tail.rpartition("</main>")[2]


def find_changes(before: Fragments, after: Fragments) -> dict[str, str]:
    """Find the changes: the HTML of elements by id.

    If fragments were added, removed or moved, or if something else changed, that is the whole main element.
    """
    if before.frame != after.frame:
        return {MAIN: after.html}
    return {name: html for name, html in after.elements.items() if before.elements[name] != html}
