"""Sentences of the pages, whose times and commands become elements."""

from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from farm.model import TextTime
from farm.web.pages.sentences import Sentence, format_sentence, format_time_attributes

FRIDAY = TextTime(text="Fri 22:00", at="2026-11-20T22:00:00+01:00")
SATURDAY = TextTime(text="Sat 06:00", at="2026-11-21T06:00:00+01:00")


class SentenceParser(HTMLParser):
    """Parser that records the elements of a sentence, and its text."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.text = [], ""
        self.feed(str(text))
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.text += data


def test_each_time_of_a_sentence_is_an_element():
    text = "quiet hours are from Fri 22:00 to Sat 06:00 <b>; `farm load a` at Fri 22:00"
    assert format_sentence(Sentence(text, (FRIDAY, SATURDAY))) == (
        'quiet hours are from <time datetime="2026-11-20T22:00:00+01:00">Fri 22:00</time> to '
        '<time datetime="2026-11-21T06:00:00+01:00">Sat 06:00</time> &lt;b&gt;; <code>farm load a</code> at '
        '<time datetime="2026-11-20T22:00:00+01:00">Fri 22:00</time>'
    )


def test_longer_one_of_two_times_is_found():
    distant_time = TextTime(text="Fri 22:00 20 Nov", at="2027-11-20T22:00:00+01:00")
    page = format_sentence(Sentence("until Fri 22:00 20 Nov", (FRIDAY, distant_time)))
    assert page == 'until <time datetime="2027-11-20T22:00:00+01:00">Fri 22:00 20 Nov</time>'


TEXTS = st.sampled_from([FRIDAY.text, SATURDAY.text, "<i>", "&", "a", " ", '"', "."]) | st.text(max_size=3)


@given(st.lists(TEXTS, max_size=8).map("".join).filter(lambda text: not set(text) & {"`", "\r", "\0"}))
def test_no_word_is_lost_and_only_times_are_marked(text):
    page = SentenceParser(format_sentence(Sentence(text, (FRIDAY, SATURDAY))))
    assert page.text == text
    time_count = text.count(FRIDAY.text) + text.count(SATURDAY.text)
    assert [tag for tag, _ in page.elements] == ["time"] * time_count


@given(st.text(), st.text())
def test_attributes_of_a_time_cannot_end_early(text, time_at):
    (element,) = SentenceParser(f"<text {format_time_attributes(TextTime(text=text, at=time_at))}>").elements
    assert list(element[1]) == ["data-time", "data-text"]
