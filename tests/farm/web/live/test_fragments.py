"""Pages split into fragments, and the changes between two renderings."""

from hypothesis import example, given
from hypothesis import strategies as st

from farm.web.live.fragments import MAIN_ID, find_changes, prepare_page, split_page

NAMES = st.lists(st.sampled_from(["a", "b-1", "c--", "printer-d"]), unique=True)
TEXTS = st.text("ab<>&;-! \nü", max_size=8).map(lambda text: text.replace("<", "&lt;").replace(">", "&gt;"))


def make_page(elements, extra=""):
    """Make a page as a template does."""
    parts = "".join(
        f'\n<!--live:{name}-->\n<li id="{name}">{text}</li>\n<!--/live-->' for name, text in elements.items()
    )
    body = f'<body data-live="/" data-version="">header<main id="main"><ul>{parts}</ul>{extra}</main></body>'
    return f"<html>{body}</html>"


@st.composite
def draw_pages(draw):
    return {name: draw(TEXTS) for name in draw(NAMES)}, draw(st.sampled_from(["", "x"]))


def apply_changes(state, changes):
    """Return the page of a browser after some changes, as elements by name in their order."""
    if MAIN_ID in changes:
        return split_main(changes[MAIN_ID])
    return {name: changes.get(name, html) for name, html in state.items()}


def split_main(main):
    """Find the elements in the HTML of the main element."""
    pieces = main.split('<li id="')[1:]
    return {piece.partition('"')[0]: f'<li id="{piece.partition("</li>")[0]}</li>' for piece in pieces}


@given(draw_pages(), draw_pages())
@example(({"a": "", "b-1": ""}, ""), ({"b-1": "", "a": ""}, ""))
def test_changes_lead_from_one_page_to_the_next(old_parts, new_parts):
    sources = [make_page(*page) for page in (old_parts, new_parts)]
    old_page, new_page = map(split_page, sources)
    changes = find_changes(old_page, new_page)
    assert (
        apply_changes(split_main(old_page.html), changes)
        == split_main(new_page.html)
        == dict(new_page.elements)
    )
    assert (changes == {}) == (sources[0] == sources[1]) == (old_page.version == new_page.version)


@given(draw_pages())
def test_page_is_sent_without_marks_and_with_its_version(page):
    sent_page = prepare_page(make_page(*page))
    assert "<!--" not in sent_page
    assert f'data-version="{split_page(make_page(*page)).version}"' in sent_page
    assert sent_page.startswith("<html><body data-live") and sent_page.endswith("</main></body></html>")
    assert split_main(sent_page).keys() == page[0].keys()


def test_only_the_changed_element_is_sent():
    old_page, new_page = (split_page(make_page({"a": "1", "b": text})) for text in ("2", "3"))
    assert find_changes(old_page, new_page) == {"b": '<li id="b">3</li>'}


def test_page_without_a_version_is_sent_as_it_is():
    assert prepare_page("<main>x</main>") == "<main>x</main>"
