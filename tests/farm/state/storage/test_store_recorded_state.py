"""Books and journals of an installation of farm 0.1.0."""

from drivers.messages import PrintPhase
from drivers.records import JOURNAL, Journal
from farm.model import Bed, JobState, Part, PrintState, Verdict
from farm.state.plate_state import PlateState
from farm.state.storage.store import Store
from farms.recorded_state import unpack_state


def test_books_of_the_first_release_are_readable(tmp_path):
    books = Store(unpack_state(tmp_path) / "farm.db").load()
    states = {number: job.state for number, job in books.jobs.items()}
    assert states == {
        1: JobState.DONE,
        2: JobState.PRINTING,
        3: JobState.HELD,
        4: JobState.PRINTED,
        5: JobState.CANCELLED,
    }
    (good_print,) = books.list_job_prints(books.get_job(1))
    assert (good_print.state, good_print.verdict, good_print.printer) == (
        PrintState.DONE,
        Verdict.GOOD,
        "um2-01",
    )
    (printing_print,) = books.list_open_prints()
    assert (printing_print.job, printing_print.printer, printing_print.state) == (
        2,
        "um2x-01",
        PrintState.PRINTING,
    )
    (plate,) = books.list_plates(books.get_job(4))
    assert books.find_plate_state(plate) is PlateState.PRINTED
    assert round(plate.expected_s / 60) == 18 and plate.family == "ultimaker2_plus"
    (part,) = (books.parts[name] for name in plate.parts)
    assert part.geometry.volume_mm3 > 2000.0 and part.print_options.stands
    assert Part.model_validate_json(part.model_dump_json()) == part
    first_printer = books.get_printer("um2-01")
    assert (first_printer.bed, round(first_printer.reel.grams)) == (Bed.NOT_CLEAR, 697)


def test_journals_of_the_first_release_are_readable(tmp_path):
    state = unpack_state(tmp_path)
    ended_journal = Journal(state / "agents" / "um2-01" / JOURNAL).state
    assert len(ended_journal.ended_print_ids) == 2 and not ended_journal.may_be_hot
    assert ended_journal.print is None or ended_journal.print.phase is PrintPhase.DONE
    open_journal = Journal(state / "agents" / "um2x-01" / JOURNAL).state
    assert (
        open_journal.print.phase is PrintPhase.PRINTING
        and open_journal.may_be_hot
        and open_journal.print.extruded
    )
