"""Queue of waiting plates: summaries computed for each job equal those computed for each plate."""

from hypothesis import given
from hypothesis import strategies as st

from books.scheduling_examples import make_plate
from farm.scheduling import PlateQueue, Requirements

ranks_by_job = {1: (0, None), 2: (1, None), 3: (0, 0.5)}  # priority and rank of each job
plates = st.lists(
    st.builds(
        lambda name, job, material, **changes: make_plate(
            name,
            job=job,
            priority=ranks_by_job[job][0],
            rank=ranks_by_job[job][1],
            extra_printer_count={1: None, 2: 3, 3: 0}[job],
            requirements=Requirements(material, None, 0.4),
            **changes,
        ),
        st.uuids().map(str),
        st.sampled_from(list(ranks_by_job)),
        st.sampled_from(["generic_pla", "generic_abs", None]),
        planned_printer=st.sampled_from("abc"),
        expected_s=st.floats(60, 1e5),
        not_before_s=st.sampled_from([None, 10.0, 20.0]),
        is_reprint=st.booleans(),
    ),
    unique_by=lambda plate: plate.id,
)


@given(plates)
def test_summaries_of_a_queue_match_its_plates(waiting_plates):
    queue = PlateQueue.from_plates(waiting_plates)
    assert list(queue) == sorted(waiting_plates, key=lambda plate: plate.priority_key)
    assert len(queue) == len(waiting_plates) and bool(queue) is bool(waiting_plates)
    assert all(plate in queue for plate in waiting_plates)
    assert queue.planned_printers == {plate.planned_printer for plate in waiting_plates}
    assert queue.demands == {plate.demand for plate in waiting_plates}
    assert queue.earliest_starts_s == {plate.not_before_s for plate in waiting_plates} - {None}
    assert list(queue.reprints) == [plate for plate in queue if plate.is_reprint]
    assert queue.extra_printer_counts == {
        plate.job: plate.extra_printer_count for plate in waiting_plates if plate.job != 1
    }


@given(plates, st.data())
def test_queue_after_a_removal_equals_a_queue_of_the_other_plates(waiting_plates, data):
    removed_plates = data.draw(st.sets(st.sampled_from(waiting_plates or [make_plate("x", "a")])))
    removed_ids = {plate.id for plate in removed_plates}
    queue = PlateQueue.from_plates(waiting_plates)
    remaining_queue = queue.without(removed_ids)
    assert remaining_queue == PlateQueue.from_plates(p for p in waiting_plates if p.id not in removed_ids)
    unchanged_jobs = {plate.job for plate in waiting_plates} - {plate.job for plate in removed_plates}
    assert all(job in remaining_queue.jobs for job in queue.jobs if job.job in unchanged_jobs)


@given(plates, st.sets(st.sampled_from(["generic_pla", "generic_abs", None])))
def test_plates_with_demands_keep_their_order(waiting_plates, materials):
    queue = PlateQueue.from_plates(waiting_plates)
    demands = {(material, None, 0.4, None, ()) for material in materials}
    selected_plates = list(queue.list_plates_with_demands(demands))
    assert [plate for _, job_plates in selected_plates for plate in job_plates] == [
        plate for plate in queue if plate.requirements.material in materials
    ]
    assert all(rank == plate.queue_rank for rank, job_plates in selected_plates for plate in job_plates)
