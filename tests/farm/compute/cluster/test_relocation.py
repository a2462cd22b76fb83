"""Pickled calls and results whose paths are mapped."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from farm.compute.cluster.relocation import Relocation, dump, load, run_relocated

NAMES = st.lists(st.sampled_from(["a", "b", "job-1", "rebalanced", "p.stl"]), min_size=1, max_size=4)
PATHS = NAMES.map(lambda names: "/" + "/".join(names))


def test_longest_matching_path_is_replaced_and_other_paths_are_unchanged():
    relocation = Relocation.from_pairs([("/state/job-1", "/here/0"), ("/state/job-1/rebalanced", "/here/1")])
    assert relocation.map_path("/state/job-1/p01.stl") == "/here/0/p01.stl"
    assert relocation.map_path("/state/job-1/rebalanced/p01.stl") == "/here/1/p01.stl"
    assert relocation.map_path("/state/job-10/p01.stl") == "/state/job-10/p01.stl"
    assert relocation.map_path("/state/job-1") == "/here/0"


@given(st.lists(PATHS, max_size=4, unique=True), PATHS)
def test_reversed_relocation_restores_the_path(sources, path):
    relocation = Relocation.from_pairs((source, f"/here/{number}") for number, source in enumerate(sources))
    assert relocation.reverse().map_path(relocation.map_path(path)) == path


def swap_files(files, name):
    return {"first": files[1], "second": files[0], "name": name}


def test_call_has_the_paths_of_the_worker_and_its_result_those_of_the_caller():
    relocation = Relocation.from_pairs([("/state", "/here")])
    call = dump((swap_files, ((Path("/state/a"), Path("/usr/b")), "/state/text")))
    assert load(call, relocation)[1] == ((Path("/here/a"), Path("/usr/b")), "/state/text")
    result = load(run_relocated(call, relocation))
    assert result == {"first": Path("/usr/b"), "second": Path("/state/a"), "name": "/state/text"}
