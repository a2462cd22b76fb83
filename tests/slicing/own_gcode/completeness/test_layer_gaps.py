"""Gaps between layers in files of Cura with little missing filament."""

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from model_files.make_gcode import FILAMENT_MM2, make_marlin, make_square, make_ultigcode
from model_files.own_gcode import accept, assert_refused, check_rules
from slicing.own_gcode.completeness import LayerGaps

SMALL_TOWER = make_square(side_mm=2.0, layers=20)  # 0.1 mm of filament in a layer
WRITERS = pytest.mark.parametrize("write", [make_marlin, make_ultigcode])


def remove_layers(lines, *numbers):
    """Remove layers from the text of a file."""
    starts = [index for index, line in enumerate(lines) if line.startswith(";LAYER:")]
    print_indices = [
        index for index, line in enumerate(lines) if line.startswith(("G1 F1800", ";TIME_ELAPSED"))
    ]
    bounds = [*starts, print_indices[-1] + 1]
    removed_indices = {index for number in numbers for index in range(bounds[number], bounds[number + 1])}
    return [line for index, line in enumerate(lines) if index not in removed_indices]


def renumber_layers(lines, first_number, step):
    """Shift the numbers of the layers from `first_number` on, as if those between were empty."""
    numbers = {f";LAYER:{n}": f";LAYER:{n + step}" for n in range(first_number, 20)}
    return [numbers.get(line, line) for line in lines]


@WRITERS
@pytest.mark.parametrize("lost_layers", [(0,), (7,), (3, 4, 5), (2, 9, 18)])
def test_missing_thin_layers_are_detected_by_their_numbers(write, lost_layers):
    complete_lines = write(SMALL_TOWER)
    assert accept(complete_lines).layers == 20
    assert_refused(
        remove_layers(complete_lines, *lost_layers),
        r"line \d+: the first move that feeds after ;LAYER:.*lines are missing",
    )


@WRITERS
def test_gap_of_empty_layers_is_accepted(write):
    assert check_rules(accept(renumber_layers(write(SMALL_TOWER), 8, 3)))


@pytest.mark.parametrize(("missing_mm", "is_lost"), [(0.0, False), (0.002, True)])
def test_filament_that_is_primed_in_every_layer_is_not_missing(missing_mm, is_lost):
    gaps = LayerGaps(0.1)
    for number in (0, 1, 3, 4):
        gaps.begin_layer(number)
        gaps.record_extrusion(0.0, 0.03 + missing_mm * (number == 3), 1)
        gaps.record_extrusion(10.0, 0.125, 2)
    assert (gaps.describe_loss() is not None) == is_lost


def add_header(lines, *figures):
    head = [";Generated with Cura_SteamEngine 4.13.0", *(f";{figure}" for figure in figures)]
    return [lines[0], *head, *lines[1:], ";End of Gcode"]


@pytest.mark.parametrize("is_relative", [False, True])
def test_lowest_and_highest_layer_match_the_figures_of_the_slicer(is_relative):
    complete_lines = add_header(
        make_marlin(SMALL_TOWER, relative=is_relative), "LAYER_COUNT:20", "MINZ:0.2", "MAXZ:4"
    )
    assert check_rules(accept(complete_lines))
    assert_refused(
        remove_layers(complete_lines, 0),
        "a lowest Z of 0.2, but it begins at Z 0.4|the first move that feeds",
    )
    assert_refused(
        remove_layers(complete_lines, 19), "a highest Z of 4, but it ends at Z 3.8: lines are missing"
    )
    for placeholder in ("TIME:6666", "MINZ:2.14748e+06"):
        assert accept(
            remove_layers([*complete_lines[:2], f";{placeholder}", *complete_lines[2:]], 5)
            if is_relative
            else complete_lines
        )


def test_hop_above_the_highest_layer_does_not_count_as_a_layer():
    lines = make_marlin(SMALL_TOWER)
    lines[lines.index(";LAYER:19") + 1 : lines.index(";LAYER:19") + 1] = ["G0 Z5"]
    complete_lines = add_header(lines, "LAYER_COUNT:20", "MINZ:0.2", "MAXZ:5")
    assert check_rules(accept(complete_lines))
    assert_refused(remove_layers(complete_lines, 18, 19), "a highest Z of 5, but it ends at Z 3.6")


def test_end_of_the_last_layer_matches_the_time_of_the_slicer():
    figures = (
        f"TIME:200 MATERIAL:{round(accept(make_ultigcode(SMALL_TOWER)).filament_mm * FILAMENT_MM2)}".split()
    )
    complete_lines = [
        line for line in make_ultigcode(SMALL_TOWER) if not line.startswith((";TIME:", ";MATERIAL:"))
    ]
    complete_lines[1:1] = [f";{figure}" for figure in figures]
    assert check_rules(accept(complete_lines))
    assert accept([line.replace("ED:200.0", "ED:200.9") for line in complete_lines])
    assert_refused(remove_layers(complete_lines, 19), "a time of 200 s, but its last layer ends after 190 s")


def remove_lines(lines, number, end_layer):
    """Remove the lines from the middle of a layer to the middle of another one."""
    layer_indices = [lines.index(f";LAYER:{layer}") for layer in (number, end_layer)]
    middles = [
        [index for index in range(start, len(lines)) if "G1 F1800" in lines[index]][1]
        for start in layer_indices
    ]
    return lines[: middles[0]] + lines[middles[1] + (number == end_layer) :]


@WRITERS
@pytest.mark.parametrize("end_layer", [7, 9])
def test_lines_missing_between_two_layers_are_detected_by_the_filament(write, end_layer):
    assert_refused(
        remove_lines(write(SMALL_TOWER), 6, end_layer),
        r"line \d+: the move feeds 0\.\d+ mm of filament more than its line",
    )


@WRITERS
def test_large_loss_within_a_layer_is_detected(write):
    complete_lines = write(make_square(side_mm=30.0, layers=20))
    assert_refused(
        remove_lines(complete_lines, 6, 6),
        r"line \d+: the move feeds 0\.2\d+ mm of filament more than its line takes",
    )
    assert accept(complete_lines).layers == 20


def test_thick_line_among_thin_ones_is_accepted():
    """Accept lines of variable width, which do not mean that layers are missing."""
    for fed_mm, is_lost in ((0.3, False), (0.6, True)):
        gaps = LayerGaps(0.1)
        for number in range(4):
            gaps.begin_layer(number)
            for index in range(5):
                gaps.record_extrusion(20.0, fed_mm if (number, index) == (2, 3) else 0.2, index)
        assert (gaps.describe_loss() is not None) == is_lost


flows = st.floats(0.002, 0.08)
lengths_mm = st.floats(0.05, 100.0)


@given(
    flow=flows,
    layers=st.lists(st.lists(lengths_mm, min_size=2, max_size=5), min_size=3, max_size=6),
    lost_layer=st.integers(1, 4),
)
def test_gap_is_a_loss_if_the_next_move_extrudes_too_much(flow, layers, lost_layer):
    """Omit a layer, with or without its filament, where E has a resolution of 1e-5 mm."""
    lost_layer = min(lost_layer, len(layers) - 2)
    missing_mm = flow * sum(layers[lost_layer])
    noise = 2e-5 / min(map(min, layers))  # relative error of the flow in the shortest line
    assume(missing_mm > 3e-4 + (0.02 * flow + noise) * layers[lost_layer + 1][0])
    for carried_mm in (0.0, missing_mm):
        gaps = LayerGaps(0.1)
        for number, layer_lengths_mm in enumerate(layers):
            if number == lost_layer:
                continue
            gaps.begin_layer(number)
            for index, length_mm in enumerate(layer_lengths_mm):
                extra_mm = carried_mm if number == lost_layer + 1 and not index else 0.0
                gaps.record_extrusion(length_mm, round(flow * length_mm + extra_mm, 5), 1)
        assert (gaps.describe_loss() is not None) == bool(carried_mm)
