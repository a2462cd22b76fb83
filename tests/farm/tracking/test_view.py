"""What a person is shown of the books."""

import dataclasses
from pathlib import Path

import pytest

from farm.config import Fleet
from farm.paths import StateFolder
from farm.tracking.view import Scene, job_view
from make_books import printing

FLEET = Fleet.model_validate(
    {
        "fleet": {"currency": "EUR"},
        "printers": [{"name": name, "model": "m", "port": f"/dev/{name}"} for name in "abc"],
    }
)


def priced(*prices):
    """A planned job whose plates cost so much."""
    books = printing(plates=len(prices))
    plates = {
        name: plate.model_copy(update={"price": price})
        for (name, plate), price in zip(books.plates.items(), prices, strict=True)
    }
    return dataclasses.replace(books, plates=plates)


def view(books):
    return job_view(Scene(FLEET, books, {}, StateFolder(Path("/state")), now_s=10.0), books.job(1))


def test_a_job_costs_what_its_plates_cost():
    seen = view(priced(1.25, 0.5))
    assert [plate.price for plate in seen.plates] == [1.25, 0.5]
    assert (seen.price, seen.currency) == (pytest.approx(1.75), "EUR")
    assert (seen.grams, seen.filament_mm) == (pytest.approx(6.0), pytest.approx(800.0))


def test_a_job_has_no_price_where_one_reel_has_none():
    assert view(priced(1.25, None)).price is None
