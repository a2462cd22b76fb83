"""The conversation with one board over a serial wire."""

from drivers.link.link import Link, Phase
from drivers.link.outbox import Source
from drivers.link.replies import Event, Events, Report, Said, Trouble, Up

__all__ = ["Event", "Events", "Link", "Phase", "Report", "Said", "Source", "Trouble", "Up"]
