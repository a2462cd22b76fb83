"""One page that says how a job went: figures, the Gantt of the fleet, what failed and why, its parts. Pure.

The page is one file: its pictures are in it, and it loads nothing.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from html import escape

from farm import api
from farm.model import PrintState, Verdict
from farm.text import span

_WIDTH, _ROW, _LEFT, _TOP = 1000, 22, 110, 24  # px of the Gantt
_TICKS = 8  # marks of time, about
_STEPS_S = (600, 1800, 3600, 7200, 14400, 28800, 86400, 172800, 604800)

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1060px; color: #222 }
body { padding: 0 1rem }
h1 { font-size: 1.5rem }
h2 { font-size: 1.1rem; margin-top: 2rem }
table { border-collapse: collapse }
td, th { text-align: left; padding: .2rem .9rem .2rem 0; vertical-align: top }
th { font-weight: 600; border-bottom: 1px solid #bbb }
.bad { color: #b3261e }
.facts td:first-child { color: #666 }
figure { display: inline-block; margin: 0 1rem 1rem 0; width: 200px; vertical-align: top }
figcaption { font-size: .85rem }
figure img { max-width: 200px; max-height: 160px }
.assembly { max-width: 100% }
svg text { font: 12px system-ui, sans-serif }
.key { margin-right: 1.2rem; white-space: nowrap }
.key span { display: inline-block; width: 1em; height: .8em; margin-right: .4em }
"""

COLOURS = {
    "good": "#2e7d4f",
    "printed": "#4a86c5",
    "bad": "#d9822b",
    "failed": "#b3261e",
    "cancelled": "#8a8a8a",
    "printing": "#b9d4ee",
    "another job": "#dddddd",
}


@dataclass(frozen=True, slots=True)
class Bar:
    """A print in the Gantt."""

    printer: str
    start: datetime
    end: datetime
    kind: str  # of COLOURS
    label: str
    text: str  # shown when a mouse is over it


def list_bars(job: api.JobView, others: Sequence[api.HistoryRow], now: datetime) -> list[Bar]:
    """Every print of a job, and those of other jobs on its printers meanwhile."""
    own = []
    for attempt in job.prints:
        if attempt.started is None:
            continue
        end = datetime.fromisoformat(attempt.ended) if attempt.ended else now
        kind = outcome_of(attempt.state, attempt.verdict)
        why = attempt.reason or attempt.why
        text = f"{attempt.part} on {attempt.printer}: {kind}" + (f", {why}" if why else "")
        number = attempt.part.rpartition("/")[2].removeprefix("p")
        start = datetime.fromisoformat(attempt.started)
        own.append(Bar(attempt.printer, start, max(start, end), kind, number, text))
    if not own:
        return []
    first, last = min(bar.start for bar in own), max(bar.end for bar in own)
    return own + [
        Bar(row.printer, start, end, "another job", "", f"{row.part} of another job")
        for row in others
        if row.job != job.id and row.started and row.ended
        for start, end in [(datetime.fromisoformat(row.started), datetime.fromisoformat(row.ended))]
        if end > first and start < last
    ]


def outcome_of(state: PrintState, verdict: Verdict | None) -> str:
    """What became of a print, as the Gantt colours it."""
    if state is PrintState.DONE:
        return str(verdict) if verdict else "printed"
    return str(state) if state.ended else "printing"


def draw_gantt(rows: Sequence[Bar]) -> str:
    """The fleet over time as SVG: a row for each printer, a bar for each print."""
    if not rows:
        return "<p>Nothing of it has been printed.</p>"
    printers = sorted({bar.printer for bar in rows})
    own = [bar for bar in rows if bar.kind != "another job"]
    first, last = min(bar.start for bar in own), max(bar.end for bar in own)
    span_s = max(1.0, (last - first).total_seconds())

    def x(at: datetime) -> float:
        share = (at - first).total_seconds() / span_s
        return _LEFT + (_WIDTH - _LEFT - 10) * min(1.0, max(0.0, share))

    height = _TOP + _ROW * len(printers) + 4
    parts = [f'<svg viewBox="0 0 {_WIDTH} {height}" width="100%" role="img" aria-label="Gantt of the fleet">']
    step_s = next((step for step in _STEPS_S if span_s / step <= _TICKS), _STEPS_S[-1])
    midnight = first.replace(hour=0, minute=0, second=0, microsecond=0)
    mark = midnight + timedelta(seconds=step_s * -(-(first - midnight).total_seconds() // step_s))
    while mark <= last:
        parts.append(
            f'<line x1="{x(mark):.1f}" x2="{x(mark):.1f}" y1="{_TOP - 4}" y2="{height}" stroke="#ddd"/>'
        )
        parts.append(f'<text x="{x(mark):.1f}" y="14" text-anchor="middle">{mark:%a %H:%M}</text>')
        mark += timedelta(seconds=step_s)
    for number, printer in enumerate(printers):
        y = _TOP + _ROW * number
        parts.append(f'<text x="0" y="{y + 15}">{escape(printer)}</text>')
        for bar in (bar for bar in rows if bar.printer == printer):
            wide = max(1.5, x(bar.end) - x(bar.start))
            parts.append(
                f'<g><title>{escape(bar.text)}</title><rect x="{x(bar.start):.1f}" y="{y + 2}" rx="2" '
                f'width="{wide:.1f}" height="{_ROW - 5}" fill="{COLOURS[bar.kind]}"/>'
            )
            if wide > 8 * len(bar.label):
                ink = "#333" if bar.kind in ("printing", "another job") else "#fff"
                parts.append(f'<text x="{x(bar.start) + 4:.1f}" y="{y + 15}" fill="{ink}">{bar.label}</text>')
            parts.append("</g>")
    return "".join([*parts, "</svg>", _key(rows)])


def _key(rows: Sequence[Bar]) -> str:
    used = {bar.kind for bar in rows}
    keys = (
        f'<span class="key"><span style="background:{colour}"></span>{kind}</span>'
        for kind, colour in COLOURS.items()
        if kind in used
    )
    return f"<p>{''.join(keys)}</p>"


def render_page(
    job: api.JobView,
    others: Sequence[api.HistoryRow],
    now: datetime,
    facts: Sequence[tuple[str, str]],
    pictures: Mapping[str, bytes],
    assembly: bytes | None,
) -> str:
    """The page.

    Parameters
    ----------
    job, others
        The job, and the prints of all jobs.
    now
        The farm's time: prints that have not ended are drawn up to it.
    facts
        Its figures, each with a name, as a person reads them.
    pictures
        PNG of each part, by its id; a part without one is only named.
    assembly
        PNG of all parts, pulled apart.
    """
    title = f"Job {job.id}: {escape(job.name)}, {job.state}"
    sections = [f"<h1>{title}</h1>"]
    if job.reason:
        sections.append(f'<p class="bad">{escape(job.reason)}</p>')
    rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(text)}</td></tr>" for name, text in facts)
    sections.append(f'<table class="facts">{rows}</table>')
    sections.append(f"<h2>The fleet</h2>{draw_gantt(list_bars(job, others, now))}")
    sections.append(f"<h2>What went wrong</h2>{_wrong(job)}")
    if job.repairs:
        items = "".join(f"<li>{escape(line)}</li>" for line in job.repairs)
        sections.append(f"<h2>What was done to the model</h2><ul>{items}</ul>")
    figures = "".join(_figure(part, job, pictures.get(part.id)) for part in job.parts)
    sections.append(f"<h2>The parts</h2>{figures or '<p>None yet.</p>'}")
    if assembly is not None:
        sections.append(
            f'<h2>All of them</h2><img class="assembly" alt="parts, pulled apart" src="{_data(assembly)}">'
        )
    head = f'<meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(sections)}</body></html>\n'


def _wrong(job: api.JobView) -> str:
    rows = [
        (
            attempt.part,
            attempt.printer,
            attempt.ended or "",
            kind,
            attempt.reason or attempt.why or attempt.fault or "",
        )
        for attempt in job.prints
        if (kind := outcome_of(attempt.state, attempt.verdict)) in ("failed", "bad", "cancelled")
    ]
    if not rows:
        return "<p>Nothing.</p>"
    cells = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in (part, printer, _short(at), kind, why))}</tr>"
        for part, printer, at, kind, why in sorted(rows, key=lambda row: row[2])
    )
    return f"<table><tr><th>part<th>printer<th>ended<th>outcome<th>why</tr>{cells}</table>"


def _figure(part: api.PartView, job: api.JobView, picture: bytes | None) -> str:
    plate = next(plate for plate in job.plates if plate.id == part.plate)
    prints = part.own_prints
    state = outcome_of(prints[-1].state, prints[-1].verdict) if prints else "waits"
    tries = f", {len(prints)} prints" if len(prints) > 1 else ""
    image = f'<img alt="{escape(part.id)}" src="{_data(picture)}">' if picture else ""
    caption = f"<b>{escape(part.id)}</b> {state}{tries}<br>{escape(plate.printer)}, {plate.grams:.0f} g"
    caption += f"<br>{_times(prints[-1] if prints else None, plate.estimated_s)}"
    if part.cut_from:
        caption += f"<br>cut again from {escape(part.cut_from)}"
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _times(last: api.PrintView | None, expected_s: float) -> str:
    """What a part took, against what it was expected to take."""
    if last is None or last.state is not PrintState.DONE or not (last.started and last.ended):
        return f"expected {span(expected_s)}"
    took = datetime.fromisoformat(last.ended) - datetime.fromisoformat(last.started)
    return f"{span(took.total_seconds())}, expected {span(expected_s)}"


def _short(iso: str) -> str:
    return datetime.fromisoformat(iso).strftime("%a %H:%M") if iso else ""


def _data(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"
