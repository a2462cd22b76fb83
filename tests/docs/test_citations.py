"""Check that every section of the serial protocol that the code cites exists."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = "docs/explanation/ultimaker2-serial.md"
CITATION_PATTERN = re.compile(re.escape(DOCUMENT) + r",\s+sections? ([\d.]*\d(?:(?:, | and )[\d.]*\d)*)")


def test_every_section_that_the_code_cites_exists():
    headings = set(re.findall(r"^##+ ([\d.]*\d) ", (ROOT / DOCUMENT).read_text(), re.MULTILINE))
    sources = [path for folder in ("drivers", "tests/drivers") for path in (ROOT / folder).rglob("*.py")]
    cited_sections = {
        (str(path.relative_to(ROOT)), section)
        for path in sources
        for sections in CITATION_PATTERN.findall(path.read_text().replace("\n# ", "\n"))
        for section in re.split(", | and ", sections)
    }
    assert len(cited_sections) > 10
    assert [(path, section) for path, section in sorted(cited_sections) if section not in headings] == []
