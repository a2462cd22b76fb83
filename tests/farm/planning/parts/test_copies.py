"""Copies: the number of parts of each, and one plan for all of them."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from books.decompose_tasks import join_slices, make_decompose_task, make_plate_result, make_slice_tasks
from books.make_books import make_plan_event
from farm.config import Fleet
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, TimeFactors
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.parts.copies import (
    MAX_PLATES,
    choose_evenly_spaced_items,
    iterate_part_counts,
    multiply_plan,
)
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.job_drawing import draw_job_parts
from farm.planning.plan import DecomposeTask, Plan
from farm.planning.plan_storage import store_plan

PRINTER_MODEL = "ultimaker2_plus"


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 3))
def test_fewer_rounds_come_before_more_parts_and_all_printers_are_tried(copies, printers, rounds):
    max_count = printers * rounds
    counts = list(iterate_part_counts(copies, printers, max_count))
    assert counts[-1][1] == max_count
    # With one round fewer, not every copy could have a part.
    assert counts[0][0] == -(-copies // printers)
    for (rounds_a, parts_a), (rounds_b, parts_b) in pairwise(counts):
        assert rounds_a < rounds_b and parts_a < parts_b
    for round_count, parts in counts:
        assert copies * parts <= round_count * printers


@given(st.lists(st.integers(), min_size=1, max_size=30), st.data())
def test_items_are_chosen_in_proportion_to_their_counts(items, data):
    count = data.draw(st.integers(1, len(items)))
    chosen_items = choose_evenly_spaced_items(sorted(items), count)
    assert len(chosen_items) == count
    item_counts = Counter(chosen_items)
    for item, available_count in Counter(items).items():
        assert abs(item_counts[item] - available_count * count / len(items)) < 1.0


def make_copy_plan(*durations_s):
    """Make the plan of one copy with a plate for each of these times."""
    event = make_plan_event(plates=len(durations_s))
    plates = tuple(
        plate.model_copy(update={"sliced_s": duration_s, "expected_s": duration_s + 10.0, "printer": "p0"})
        for plate, duration_s in zip(event.plates, durations_s, strict=True)
    )
    return Plan(event.parts, plates, (), 1.0, 100.0)


def make_task(fleet, tmp_path, factors=None, **options):
    sections = Fleet.model_validate(
        {
            "printers": [
                {"name": name, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}", **changes}
                for name, changes in fleet.items()
            ]
        }
    ).printers
    return DecomposeTask(
        1, tmp_path, JobOptions(**options), sections, 1, tmp_path, time_factors=factors or {}
    )


def test_plan_of_one_copy_is_unchanged(tmp_path):
    plan = make_copy_plan(50.0)
    assert multiply_plan(plan, make_task({"p0": {}}, tmp_path)) is plan


def test_each_copy_has_every_part_with_its_number(tmp_path):
    printers = {f"p{i}": {} for i in range(4)}
    plan = multiply_plan(make_copy_plan(50.0, 90.0), make_task(printers, tmp_path, copies=2))
    assert [(part.id, part.plate, part.copy_number) for part in plan.parts] == [
        ("1/p01.1", "1/01.1", 1),
        ("1/p02.1", "1/02.1", 1),
        ("1/p01.2", "1/01.2", 2),
        ("1/p02.2", "1/02.2", 2),
    ]
    assert [(plate.id, plate.parts) for plate in plan.plates] == [
        (part.plate, (part.id,)) for part in plan.parts
    ]
    assert {plate.printer for plate in plan.plates} == set(printers)
    assert plan.serial_s == 200.0
    assert plan.expected_s == 100.0


def test_plates_go_to_matching_printers_and_fewer_to_slow_ones(tmp_path):
    printers = {"p0": {}, "p1": {}, "p2": {"nozzle_mm": 0.8}, "p3": {"material": "generic_abs"}}
    task = make_task(printers, tmp_path, factors={"p1": TimeFactors(1.25)}, copies=9)
    plan = multiply_plan(make_copy_plan(100.0), task)
    plate_counts = Counter(plate.printer for plate in plan.plates)
    assert plate_counts == {"p0": 5, "p1": 4}
    assert {(p.printer, p.time_factor, p.expected_s) for p in plan.plates} == {
        ("p0", 1.0, 110.0),
        ("p1", 1.25, 135.0),
    }
    assert plan.expected_s == 550.0


def test_planned_printers_do_not_exceed_the_request(tmp_path):
    printers = {f"p{i}": {} for i in range(4)}
    plan = multiply_plan(make_copy_plan(100.0), make_task(printers, tmp_path, copies=4, printers=2))
    assert {plate.printer for plate in plan.plates} == {"p0", "p1"}


def test_more_plates_than_a_job_may_have_are_refused(tmp_path):
    plan = make_copy_plan(*[50.0] * 5)
    with pytest.raises(FarmError, match="submit fewer copies") as error:
        multiply_plan(plan, make_task({"p0": {}}, tmp_path, copies=MAX_PLATES // 5 + 1))
    assert error.value.code is ErrorCode.SETTINGS


@given(
    st.lists(st.floats(10.0, 1e5), min_size=1, max_size=6),
    st.integers(2, 12),
    st.lists(st.floats(0.8, 1.25), min_size=1, max_size=6),
)
def test_loads_are_balanced(tmp_path_factory, durations_s, copies, factors):
    """Check that no printer ends more than one plate later than the first one."""
    factors_by_printer = {f"p{i}": TimeFactors(factor) for i, factor in enumerate(factors)}
    task = make_task(
        {name: {} for name in factors_by_printer},
        tmp_path_factory.getbasetemp(),
        factors_by_printer,
        copies=copies,
    )
    plan = multiply_plan(make_copy_plan(*durations_s), task)
    loads_s = dict.fromkeys(factors_by_printer, 0.0)
    for plate in plan.plates:
        loads_s[plate.printer] += plate.expected_s
    longest_s = max(duration_s * 1.25 + 10.0 for duration_s in durations_s)
    assert max(loads_s.values()) <= min(loads_s.values()) + longest_s + 1e-6
    assert plan.expected_s == pytest.approx(max(loads_s.values()))
    assert len({part.id for part in plan.parts}) == copies * len(durations_s)


@pytest.fixture
def box(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((60.0, 36.0, 28.0)).export(path)
    return inspect_model(path, "box.stl", JobOptions(), files)


@pytest.mark.usefixtures("without_pictures")
def test_copies_of_a_model_too_long_for_a_bed_share_the_printers(bar, files, tmp_path):
    """Cut at least two parts: four printers print two copies at the same time, three need two rounds."""
    for printers, copies, parts in ((4, 2, 2), (3, 2, 3), (2, 2, 2), (8, 2, 4)):
        task = replace(
            make_decompose_task(bar, files, tmp_path, printers=printers),
            options=JobOptions(copies=copies, printers=printers),
        )
        assert len(decompose_job(task).parts) == parts, (printers, copies)


@pytest.mark.usefixtures("without_pictures")
def test_copies_with_pins_use_the_fastest_printers(bar, files, tmp_path):
    """Cut the model for two of four printers; its loads move to faster ones, for which it was not cut."""
    task = make_decompose_task(bar, files, tmp_path, printers=4)
    names = [section.name for section in task.printers]
    factors = dict(zip(names, map(TimeFactors, (1.3, 1.2, 1.1, 1.0)), strict=True))
    options = JobOptions(copies=2, printers=4, pin_mm=2.85, marks=True)
    parts = decompose_job(replace(task, options=options, time_factors=factors)).parts
    assert {part.printer for part in parts} == set(names[2:])


@pytest.mark.usefixtures("without_pictures")
def test_copies_of_a_small_model_stay_whole_unless_a_person_requests_printers(box, files, tmp_path):
    auto_task = replace(make_decompose_task(box, files, tmp_path, printers=4), options=JobOptions(copies=2))
    assert len(decompose_job(auto_task).parts) == 1
    four_printer_task = replace(auto_task, options=JobOptions(copies=2, printers=4))
    assert len(decompose_job(four_printer_task).parts) == 2
    many_copy_task = replace(auto_task, options=JobOptions(copies=9, printers=4))
    assert len(decompose_job(many_copy_task).parts) == 1


@pytest.mark.usefixtures("without_pictures")
def test_copies_are_cut_so_that_all_are_done_in_time(box, files, tmp_path):
    task = replace(make_decompose_task(box, files, tmp_path, printers=4), options=JobOptions(copies=2))
    (whole_part,) = decompose_job(task).parts
    assert len(decompose_job(replace(task, time_limit_s=whole_part.price_s * 1.2)).parts) == 1
    assert len(decompose_job(replace(task, time_limit_s=whole_part.price_s * 0.9)).parts) == 2
    # Six copies on four printers take two rounds.
    six_copy_task = replace(task, options=JobOptions(copies=6))
    assert len(decompose_job(replace(six_copy_task, time_limit_s=whole_part.price_s * 2.4)).parts) == 1


@pytest.mark.usefixtures("without_pictures")
def test_copies_reuse_cuts_slices_and_files(bar, files, tmp_path):
    options = JobOptions(copies=3, printers=6)
    task = replace(make_decompose_task(bar, files, tmp_path, printers=6), options=options)
    decomposition = decompose_job(task)
    tasks = make_slice_tasks(task, decomposition)
    gcodes = [tmp_path / f"{i}.gcode" for i in range(len(tasks))]
    for i, path in enumerate(gcodes):
        path.write_text(f"; {i}\n")
    sliced_job = join_slices(task, decomposition, tasks, [make_plate_result(600.0, path) for path in gcodes])
    draw_job_parts(task, decomposition.drawing_record)
    booked_plan = store_plan(sliced_job, files)
    stored_files = set(files.rglob("*"))
    plan = multiply_plan(booked_plan, task)
    assert set(files.rglob("*")) == stored_files
    assert len(tasks) == 2 and len(plan.plates) == 6
    assert {plate.gcode for plate in plan.plates} == {plate.gcode for plate in booked_plan.plates}
    assert len({plate.printer for plate in plan.plates}) == 6
