"""Checks of an installation: facts are collected, then evaluated by pure functions."""

from farm.doctor.checks import check_installation
from farm.doctor.collection import collect_facts
from farm.doctor.facts import Facts
from farm.doctor.finding import Finding, Level

__all__ = ["Facts", "Finding", "Level", "check_installation", "collect_facts"]
