"""Speed of a printer by feature, learned from the prints in the books."""

import random

import pytest

from books.make_books import make_plan_event
from farm.model import FeatureSeconds, Plate, Print, Printer, PrintState, TimeFactors
from farm.state.books import Books
from farm.state.printer_speed import MIN_PRINTS, learn_speed, list_timings

HOUR_S = 3600.0
OVERHEAD_S = 200.0
TRUE_FACTORS = (1.02, 0.98, 1.15, 1.0, 1.3)
(TEMPLATE,) = make_plan_event(plates=1).plates


def make_plate(number, family="ultimaker2"):
    rng = random.Random(number)
    weights = [rng.uniform(0.05, 1.0) for _ in range(5)]
    durations_s = [HOUR_S * weight / sum(weights) for weight in weights]
    features = FeatureSeconds(**dict(zip(FeatureSeconds.model_fields, durations_s, strict=True)))
    changes = {"sliced_s": HOUR_S, "expected_s": HOUR_S + OVERHEAD_S, "features": features, "family": family}
    return TEMPLATE.model_copy(update={"id": f"1/{number:03d}", "prints": (f"x{number}",), **changes})


def make_print(plate: Plate, printer="a", time_ratio=1.0, **changes):
    number = int(plate.id[2:])
    layers_s = (
        time_ratio * plate.sliced_s * TimeFactors(1.0, TRUE_FACTORS).compute_factor(plate.feature_shares)
    )
    fields = {
        "id": f"x{number}",
        "plate": plate.id,
        "job": 1,
        "printer": printer,
        "number": number,
        "assigned_s": number * 10 * HOUR_S,
        "started_s": number * 10 * HOUR_S,
        "ended_s": number * 10 * HOUR_S + layers_s + OVERHEAD_S,
        "state": PrintState.DONE,
    }
    return Print(**{**fields, **changes})


def learn_from_prints(prints, plates, **time_factors):
    """Learn from the last print; return its printer and the books."""
    names = {attempt.printer for attempt in prints}
    printers_by_name = {name: Printer(name=name, time_factor=time_factors.get(name, 1.0)) for name in names}
    books = Books.from_entities([*plates, *prints, *printers_by_name.values()])
    last_print = prints[-1]
    return learn_speed(books, printers_by_name[last_print.printer], last_print), books


def test_factors_are_learned_from_thirty_prints_of_a_printer():
    plates = [make_plate(number) for number in range(1, MIN_PRINTS + 1)]
    prints = [make_print(plate) for plate in plates]
    assert learn_from_prints(prints[1:], plates)[0].feature_factors is None
    printer, _ = learn_from_prints(prints, plates)
    assert printer.feature_factors.factors == pytest.approx(TRUE_FACTORS, abs=1e-3)
    assert (printer.feature_factors.prints, printer.feature_factors.own) == (MIN_PRINTS, True)
    wall_shares = (1.0, 0.0, 0.0, 0.0, 0.0)
    assert printer.time_factors.compute_factor(wall_shares) == pytest.approx(TRUE_FACTORS[0], abs=1e-3)


@pytest.mark.parametrize(
    "changes",
    [
        {"state": PrintState.FAILED},
        {"paused": True},
        {"starved_s": HOUR_S},
        {"started_s": None},
        {"ended_s": 1e9},
        {"ended_s": 0.0},
    ],
)
def test_unrepresentative_print_is_ignored(changes):
    plates = [make_plate(number) for number in range(1, MIN_PRINTS + 1)]
    prints = [make_print(plate) for plate in plates]
    prints[3] = make_print(plates[3], **changes)
    printer, books = learn_from_prints(prints, plates)
    assert printer.feature_factors is None
    assert len(list_timings(books, printer)) == MIN_PRINTS - 1


def test_plate_without_features_updates_only_the_time_factor():
    plates = [make_plate(number) for number in range(1, MIN_PRINTS + 1)]
    plates[-1] = plates[-1].model_copy(update={"features": None})
    prints = [make_print(plate) for plate in plates[:-1]]
    prints.append(make_print(plates[-1], ended_s=plates[-1].expected_s * 1.1 + HOUR_S * 10 * MIN_PRINTS))
    printer, _ = learn_from_prints(prints, plates)
    assert printer.feature_factors is None
    assert printer.time_factor > 1.0


def test_printer_with_few_prints_has_the_factors_of_its_family_at_its_own_speed():
    plates = [make_plate(number) for number in range(1, MIN_PRINTS + 3)]
    prints = [make_print(plate, printer="b") for plate in plates[:-2]]
    prints += [make_print(plate, printer="a", time_ratio=1.05) for plate in plates[-2:]]
    mean_ratio = sum(TRUE_FACTORS) / 5
    printer, _ = learn_from_prints(prints, plates, a=1.05 * mean_ratio, b=mean_ratio)
    assert not printer.feature_factors.own
    assert printer.feature_factors.prints == MIN_PRINTS + 2
    expected_factors = tuple(1.05 * factor for factor in TRUE_FACTORS)
    assert printer.feature_factors.factors == pytest.approx(expected_factors, abs=0.02)
    other_plates = [plate.model_copy(update={"family": "marlin"}) for plate in plates[:-2]]
    assert learn_from_prints(prints, [*other_plates, *plates[-2:]])[0].feature_factors is None


def test_only_the_latest_prints_of_a_printer_count():
    plates = [make_plate(number) for number in range(1, 101)]
    prints = [
        make_print(plate, time_ratio=1.0 if number < 40 else 1.1) for number, plate in enumerate(plates)
    ]
    printer, books = learn_from_prints(prints, plates)
    assert len(list_timings(books, printer)) == 60
    expected_factors = tuple(1.1 * factor for factor in TRUE_FACTORS)
    assert printer.feature_factors.factors == pytest.approx(expected_factors, abs=1e-3)
