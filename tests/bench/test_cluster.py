"""Stages of recorded jobs, their critical path, and tables of results."""

import pytest

from bench.cluster import REPLAY_COLUMNS, replace_table, summarise_faults
from bench.clusters.jobs import list_stages
from bench.clusters.replay import find_critical_path, sum_path

STAGES = [
    {"decompose_job": [30.0]},
    {"slice_part": [2.0, 5.0, 1.0], "draw_job_parts": [10.0]},
    {"rebalance_parts": [15.0]},
    {
        "slice_part": [3.0, 4.0],
        "draw_overview": [3.0],
        "draw_step_range": [5.0, 6.0],
        "draw_job_parts": [2.0],
    },
]


def test_tasks_are_grouped_by_the_stages_that_follow_each_other():
    order = [
        "decompose_job",
        "slice_part",
        "slice_part",
        "draw_job_parts",
        "slice_part",
        "rebalance_parts",
        "slice_part",
    ]
    tasks = [
        {"kind": kind, "begin_s": float(index), "cpu_s": 10.0 + index} for index, kind in enumerate(order)
    ]
    assert list_stages(tasks[::-1]) == [
        {"decompose_job": [10.0]},
        {"slice_part": [11.0, 12.0, 14.0], "draw_job_parts": [13.0]},
        {"rebalance_parts": [15.0]},
        {"slice_part": [16.0]},
    ]


def test_critical_path_ends_with_the_last_drawing_if_that_takes_longer():
    path = find_critical_path(STAGES)
    assert path == [
        ("decompose_job", 30.0),
        ("slice_part", 5.0),
        ("rebalance_parts", 15.0),
        ("slice_part", 3.0),
        ("draw_step_range", 6.0),
        ("draw_job_parts", 2.0),
    ]
    stages_without_drawings = [
        {kind: times for kind, times in stage.items() if "draw" not in kind} for stage in STAGES
    ]
    assert sum_path(find_critical_path(stages_without_drawings)) == pytest.approx(30.0 + 5.0 + 15.0 + 4.0)


def test_drawings_by_one_worker_lengthen_the_path():
    path = find_critical_path(STAGES, single_drawer=True)
    assert path[-1] == ("draw_job_parts", 3.0 + 5.0 + 6.0 + 2.0)
    assert sum_path(path) == sum_path(find_critical_path(STAGES)) + 8.0


def test_table_of_a_page_is_replaced():
    page = "# Page\n<!-- bench/cluster.py replay -->\nold\n<!-- end of replay -->\nrest\n"
    figures = {"duration_s": 12.34, "bound_s": 11.0, "efficiency": 0.5, "cpu_ms_per_task": 17.6}
    figures |= {"overhead_ms": 9.9, "single_drawer_s": 15.5, "ratio": 0.8}
    runs = [{"workers": n, "jobs": 2, "tasks": 30, **figures} for n in (4, 16)]
    new_page = replace_table(page, "replay", REPLAY_COLUMNS, runs)
    assert new_page.startswith("# Page\n<!-- bench/cluster.py replay -->\n| workers | jobs |")
    assert new_page.endswith("|\n<!-- end of replay -->\nrest\n")
    assert (
        "| 16 | 2 | 30 | 12 s | 11 s | 50% | 18 ms | 10 ms | 16 s | 0.80 |\n" in new_page
        and "old" not in new_page
    )
    assert replace_table(new_page, "replay", REPLAY_COLUMNS, runs) == new_page


def test_rounds_of_each_fault_are_summed_up():
    no_faults = {"results_taken_twice": 0, "remaining_tasks": 0, "extra_processes": 0}
    figures = {
        "job_ended": True,
        "during_job": True,
        "correct_tasks": 8,
        "used_local_pool": False,
        **no_faults,
    }
    rounds = [
        {
            **figures,
            "fault": "disconnect farm",
            "duration_s": 50.0,
            "differences": [],
            "used_local_pool": True,
        },
        {
            **figures,
            "fault": "kill worker",
            "duration_s": 20.0,
            "differences": [],
            "extra_processes": 2,
            "during_job": False,
        },
        {**figures, "fault": "disconnect farm", "duration_s": 60.0, "differences": ["1/01 sha256: a and b"]},
    ]
    disconnected_row, killed_row = summarise_faults(rounds)
    assert (
        disconnected_row["rounds"],
        disconnected_row["shortest_s"],
        disconnected_row["longest_s"],
        disconnected_row["same_plans"],
        disconnected_row["used_local_pool"],
    ) == (
        2,
        50.0,
        60.0,
        1,
        1,
    )
    assert (killed_row["fault"], killed_row["same_plans"], killed_row["correct_tasks"]) == (
        "kill worker",
        1,
        8,
    )
    assert (disconnected_row["extra_processes"], killed_row["extra_processes"]) == (0, 2)
    assert (disconnected_row["during_job"], killed_row["during_job"]) == (2, 0)
