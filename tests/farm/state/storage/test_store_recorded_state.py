"""Books and journals of an installation of farm 0.1.0 open as they were."""

from drivers.messages import PrintPhase
from drivers.records import JOURNAL, Journal
from farm.model import Bed, JobState, Part, PrintState, Verdict
from farm.state.plate_state import PlateState
from farm.state.storage.store import Store
from recorded_state import unpack_state


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
    (good,) = books.prints_of_job(books.job(1))
    assert (good.state, good.verdict, good.printer) == (PrintState.DONE, Verdict.GOOD, "um2-01")
    (printing,) = books.open_prints()
    assert (printing.job, printing.printer, printing.state) == (2, "um2x-01", PrintState.PRINTING)
    (plate,) = books.plates_of(books.job(4))
    assert books.plate_state(plate) is PlateState.PRINTED
    assert round(plate.expected_s / 60) == 18 and plate.family == "ultimaker2_plus"
    (part,) = (books.parts[name] for name in plate.parts)
    assert part.geometry.volume_mm3 > 2000.0 and part.print_options.stands
    assert Part.model_validate_json(part.model_dump_json()) == part
    first = books.printer("um2-01")
    assert (first.bed, round(first.reel.grams)) == (Bed.NOT_CLEAR, 697)


def test_journals_of_the_first_release_are_readable(tmp_path):
    state = unpack_state(tmp_path)
    ended = Journal(state / "agents" / "um2-01" / JOURNAL).state
    assert len(ended.ended) == 2 and not ended.may_be_hot
    assert ended.print is None or ended.print.phase is PrintPhase.DONE
    still = Journal(state / "agents" / "um2x-01" / JOURNAL).state
    assert still.print.phase is PrintPhase.PRINTING and still.may_be_hot and still.print.extruded
