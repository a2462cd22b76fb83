"""Critical path of recorded jobs, and their stages."""

import pytest

from bench.cluster import find_critical_path, sum_path
from bench.cluster_jobs import list_stages

STAGES = [
    {"decompose_job": [30.0]},
    {"slice_part": [2.0, 5.0, 1.0], "draw_job": [10.0]},
    {"relevel_parts": [15.0]},
    {"slice_part": [3.0, 4.0], "draw_job": [12.0]},
]


def test_tasks_are_grouped_by_the_stages_that_follow_each_other():
    order = [
        "decompose_job",
        "slice_part",
        "slice_part",
        "draw_job",
        "slice_part",
        "relevel_parts",
        "slice_part",
    ]
    tasks = [{"what": what, "begin_s": float(at), "cpu_s": 10.0 + at} for at, what in enumerate(order)]
    assert list_stages(tasks[::-1]) == [
        {"decompose_job": [10.0]},
        {"slice_part": [11.0, 12.0, 14.0], "draw_job": [13.0]},
        {"relevel_parts": [15.0]},
        {"slice_part": [16.0]},
    ]


def test_the_critical_path_ends_with_the_last_drawing_if_that_takes_longer():
    path = find_critical_path(STAGES)
    assert [what for what, _ in path] == [
        "decompose_job",
        "slice_part",
        "relevel_parts",
        "slice_part",
        "draw_job",
    ]
    assert sum_path(path) == pytest.approx(30.0 + 5.0 + 15.0 + 3.0 + 12.0)
    quick = [
        {what: [0.1] if what == "draw_job" else times for what, times in stage.items()} for stage in STAGES
    ]
    assert sum_path(find_critical_path(quick)) == pytest.approx(30.0 + 5.0 + 15.0 + 4.0)


def test_parts_drawn_before_they_are_sliced_lengthen_the_path():
    assert sum_path(find_critical_path(STAGES, drawn_first=True)) == pytest.approx(54.0 + 22.0)
