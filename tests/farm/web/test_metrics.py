"""Metrics of the farm, which are computed from the books, so that totals never fall."""

import pytest
from prometheus_client.parser import text_string_to_metric_families

from farm.model import PrintState
from farm.web.metrics import _PRINTER_STATES
from farms.scraped_farm import ScrapedFarm

DONE, FAILED = PrintState.DONE, PrintState.FAILED


def read_samples(text):
    """Return the samples of a scrape by name and labels."""
    return {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def sum_totals(samples):
    return {key: value for key, value in samples.items() if key[0].endswith("_total")}


def test_totals_by_outcome_never_fall_even_over_a_restart(tmp_path):
    farm = ScrapedFarm(tmp_path)
    old_totals = {}
    for state in (DONE, FAILED, DONE):
        farm.print_plate(state)
        new_totals = sum_totals(read_samples(farm.scrape()))
        assert all(new_totals[key] >= value for key, value in old_totals.items())
        old_totals = new_totals
    assert old_totals["farm_prints_total", "a", "done"] == 2
    assert old_totals["farm_prints_total", "a", "failed"] == 1
    assert old_totals["farm_print_seconds_total", "a", "done"] == pytest.approx(200.0, abs=1.0)
    farm.restart()
    assert sum_totals(read_samples(farm.scrape())) == old_totals


def test_each_printer_has_one_state_and_an_absent_reading_has_no_sample(tmp_path):
    farm = ScrapedFarm(tmp_path)
    farm.print_plate(DONE)
    samples = read_samples(farm.scrape())
    for printer in ("a", "b"):
        states = [samples["farm_printer_state", *sorted((printer, state))] for state in _PRINTER_STATES]
        assert sorted(states) == [0.0] * (len(states) - 1) + [1.0], printer
    assert samples["farm_printer_temperature_celsius", "a", "nozzle"] == 210.0
    assert ("farm_printer_temperature_celsius", "b", "nozzle") not in samples
    assert samples["farm_agent_up", "b"] == 0.0
    assert samples["farm_jobs", "printed"] == 1.0


def test_printer_on_a_lost_host_has_the_state_unknown(tmp_path):
    farm = ScrapedFarm(tmp_path)
    farm.lose_host("a")
    samples = read_samples(farm.scrape())
    assert samples["farm_printer_state", "a", "unknown"] == 1.0
    assert samples["farm_printer_state", "b", "unknown"] == 0.0


def test_no_label_names_a_job_or_a_model(tmp_path):
    farm = ScrapedFarm(tmp_path)
    farm.print_plate(DONE)
    assert "m.stl" not in farm.scrape()
    assert 'job="' not in farm.scrape()
