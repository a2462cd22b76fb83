"""Completeness of own G-code: truncated files and missing layers."""

import gzip
import json
import re
from functools import cache
from pathlib import Path

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from model_files.make_gcode import END_LINES, FILAMENT_MM2, make_marlin, make_square, make_ultigcode
from model_files.own_gcode import (
    accept,
    assert_refused,
    check_rules,
    extract_body,
    list_moves,
    select_extrusions,
)
from slicing.errors import GcodeRefused
from slicing.own_gcode.survey import survey_lines

FIXTURES = Path(__file__).parents[1] / "fixtures"
COUNTED_LINES = [";LAYER_COUNT:100", *make_marlin(make_square(layers=100))]


def format_cura_settings():
    """Format the settings that Cura appends to the engine's G-code: escaped JSON in lines of 80 bytes."""
    profile = "[general]\\nversion = 4\\nname = draft \\\\ fine\\n\\n[values]\\nadhesion_type = brim\\n"
    text = json.dumps({"global_quality": profile, "extruder_quality": [profile]})
    text = text.replace("\\", "\\\\").replace("\n", "\\n")
    return "".join(f";SETTING_3 {text[index : index + 68]}\n" for index in range(0, len(text), 68)).encode()


@cache
def read_complete_file(slicer):
    """Read a slicer's G-code of a tile or a plate from the fixtures."""
    if slicer == "cura 5":
        record = json.loads(gzip.decompress((FIXTURES / "engine-5.0.json.gz").read_bytes()))
        return record["gcode"].encode()
    if slicer == "cura and its settings":
        return read_complete_file("ultigcode") + format_cura_settings()
    return gzip.decompress((FIXTURES / f"tile-{slicer}.gcode.gz").read_bytes())


SLICERS = ["ultigcode", "cura 5", "cura and its settings", "prusaslicer"]


@pytest.mark.parametrize("slicer", [*SLICERS, "slic3r"])
def test_complete_file_is_accepted(slicer):
    check_rules(accept(read_complete_file(slicer).splitlines(keepends=True)))


def assert_cut_is_refused(file, index):
    # Without the settings that Cura adds, this file is complete.
    assume(file[:index] != read_complete_file("ultigcode"))
    with pytest.raises(GcodeRefused, match=r"line \d+|prints nothing|start of its print|its flavour"):
        accept(file[:index].splitlines(keepends=True))


@pytest.mark.parametrize("slicer", SLICERS)
@given(share=st.floats(0, 1, exclude_max=True))
@example(share=0.9999999)
@settings(max_examples=60, deadline=None)
def test_file_cut_at_any_byte_is_refused(slicer, share):
    file = read_complete_file(slicer)
    assert_cut_is_refused(file, int(share * len(file)))


@pytest.mark.parametrize("slicer", SLICERS)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_file_cut_at_the_end_of_any_line_is_refused(slicer, data):
    file = read_complete_file(slicer)
    ends = [result.end() for result in re.finditer(rb"\n", file)]
    assert_cut_is_refused(file, data.draw(st.sampled_from(ends[:-1])))


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_file_of_a_slicer_without_a_closing_mark_is_refused_before_its_end_code(data):
    """Check a file of Slic3r, which ends with settings, and one of an unknown slicer with end code only."""
    slic3r_file, unknown_file = (
        read_complete_file("slic3r"),
        "\n".join(make_marlin(make_square(layers=20))).encode() + b"\n",
    )
    for file, end in ((slic3r_file, b"; filament used"), (unknown_file, b"M104 S0")):
        ends = [result.end() for result in re.finditer(rb"\n", file[: file.index(end)])]
        assert_cut_is_refused(file, data.draw(st.sampled_from(ends)))
        assert_cut_is_refused(file, data.draw(st.sampled_from(ends)) - data.draw(st.integers(1, 2)))


def test_fewer_layers_than_the_file_states_are_refused():
    assert accept(COUNTED_LINES).layers == 100
    assert_refused(
        [line for line in COUNTED_LINES if line != ";LAYER:99"],
        "line 1 states 100 layers.* only 99",
    )
    index = COUNTED_LINES.index(";LAYER:60")
    assert_refused(
        [*COUNTED_LINES[:index], *END_LINES],
        rf"line {index + len(END_LINES)}: .* line 1 states 100 layers, but the file has only 60",
    )


@pytest.mark.parametrize(
    "count",
    ["; total layers count = 100", "; total layer number: 100", ";Layer count: 100", ";LAYER_COUNT:100"],
)
def test_layer_count_of_each_slicer_is_read(count):
    lines = [line.replace(";LAYER:", ";LAYER_CHANGE ") for line in make_marlin(make_square(layers=60))]
    assert_refused([*lines, count], "states 100 layers, but the file has only 60")
    assert accept([*lines, count.replace("100", "60")]).layers == 60


def test_layers_of_sequential_objects_are_counted_per_object():
    first_object, second_object = make_square(layers=3), make_square(at_mm=170.0, layers=3)
    lines = make_marlin([*first_object, *second_object])
    for number in (3, 4, 5):
        lines[lines.index(f";LAYER:{number}")] = f";LAYER:{number - 3}"
    starts = [n for n, line in enumerate(lines) if line == ";LAYER:0"]
    for index in reversed(starts):
        lines.insert(index, ";LAYER_COUNT:3")
    assert accept(lines).layers == 6
    assert_refused([line.replace("COUNT:3", "COUNT:5") for line in lines], "states 5 layers, .* only 3")


def test_empty_layers_that_cura_omits_cause_a_warning():
    """Accept empty layers in the tip of a spire if the closing comment is present."""
    lines = make_ultigcode(make_square(layers=20))
    lines_stating_24 = [line.replace("COUNT:20", "COUNT:24") for line in lines]
    assert "states 24 layers, but the file has only 20: Cura" in accept(lines_stating_24).notices[-1]
    assert not any("layers" in line for line in accept(lines).notices)
    assert_refused(lines_stating_24[:-1], "closes its files with a comment")
    assert_refused(
        [line.replace("COUNT:20", "COUNT:30") for line in lines], "states 30 layers, but the file has only 20"
    )


@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_file_with_missing_layers_and_an_intact_end_is_refused(data):
    """Detect a gap by the move that would extrude all its filament, and missing last layers by the count."""
    lines = read_complete_file("ultigcode").splitlines(keepends=True)
    starts = [index for index, line in enumerate(lines) if line.startswith(b";LAYER:")]
    last_index = max(index for index, line in enumerate(lines) if line.startswith(b";TIME_ELAPSED:")) + 1
    starts.append(last_index)
    first_layer = data.draw(st.integers(1, len(starts) - 2))
    end_layer = data.draw(st.integers(first_layer + 1, len(starts) - 1))
    file_with_gap = lines[: starts[first_layer]] + lines[starts[end_layer] :]
    if end_layer < len(starts) - 1:
        with pytest.raises(GcodeRefused, match=r"lines are missing|states .* layers"):
            accept(file_with_gap)
        return
    try:
        assert "layers, but" in accept(file_with_gap).notices[-1]
    except GcodeRefused as refusal:
        assert re.search("lines are missing|states .* layers", str(refusal))


def read_file_with_figures(slicer):
    """Read a file that states its filament and time, which a slicer knows only after slicing.

    Cura writes them into the header.
    """
    if slicer == "cura 5":
        record = json.loads(gzip.decompress((FIXTURES / "engine-5.0.json.gz").read_bytes()))
        [head] = re.findall(
            r"Gcode header after slicing:\n(.*?)\n+End of gcode header", record["log"], re.DOTALL
        )
        return (
            head.encode() + read_complete_file(slicer)[read_complete_file(slicer).index(b"\n\n;Generated") :]
        )
    if slicer == "ultigcode":
        return read_complete_file(slicer).replace(b":6666\n;MATERIAL:6666", b":105\n;MATERIAL:246")
    return read_complete_file(slicer)


@pytest.mark.parametrize("slicer", ["cura 5", "ultigcode", "prusaslicer", "slic3r"])
def test_file_extrudes_the_filament_that_its_slicer_states(slicer):
    lines = read_file_with_figures(slicer).splitlines(keepends=True)
    assert survey_lines(lines, 2.85).figures.filament is not None
    check_rules(accept(lines))


@pytest.mark.parametrize("slicer", ["cura 5", "ultigcode", "prusaslicer"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_file_with_stated_filament_is_refused_if_any_layer_is_missing(slicer, data):
    """Check gaps at all layers, including the last ones, and files with relative E."""
    lines = read_file_with_figures(slicer).splitlines(keepends=True)
    starts = [index for index, line in enumerate(lines) if line.startswith((b";LAYER:", b";LAYER_CHANGE"))]
    starts.append(
        max(index for index, line in enumerate(lines) if line.startswith(b"G1 X") and b"E" in line) + 1
    )
    first_layer = data.draw(st.integers(0, len(starts) - 2))
    end_layer = data.draw(st.integers(first_layer + 1, len(starts) - 1))
    with pytest.raises(GcodeRefused):
        accept(lines[: starts[first_layer] + 1] + lines[starts[end_layer] :])


def test_empty_layers_are_accepted_if_all_filament_is_present():
    lines = [line.replace("COUNT:20", "COUNT:40") for line in make_ultigcode(make_square(layers=20))]
    assert_refused(lines, "states 40 layers")
    volume_mm3 = round(accept(make_ultigcode(make_square(layers=20))).filament_mm * FILAMENT_MM2)
    figures = [line.replace("TIME:6666", "TIME:60").replace(":6666", f":{volume_mm3}") for line in lines]
    assert not any("layers" in line for line in accept(figures).notices)
    higher_figures = [line.replace(f":{volume_mm3}", f":{volume_mm3 + 2}") for line in figures]
    expected_message = (
        rf"line 3 says that it takes {volume_mm3 + 2} mm3 of filament, but its lines extrude {volume_mm3}"
    )
    assert_refused(higher_figures, expected_message)
    # The printer extrudes more than the E of the file, so the figures cannot be compared.
    lines_with_flow = [
        *higher_figures[:-6],
        "M221 S101",
        *higher_figures[-6:],
    ]
    assert_refused(lines_with_flow, "states 40 layers")
    assert accept([line.replace("COUNT:40", "COUNT:20") for line in lines_with_flow]).layers == 20


def test_move_that_feeds_the_filament_of_missing_lines_is_refused_with_its_line():
    lines = make_marlin(make_square(layers=100))
    index, end = lines.index(";LAYER:40"), lines.index(";LAYER:45")
    assert_refused(
        [*lines[:index], *lines[end:]], rf"line {index + 3}: one move feeds .* lines are missing before it"
    )


def test_missing_layer_is_reported_with_relative_e():
    """Report a missing layer, which may also be an empty one that was omitted."""
    lines = make_ultigcode(make_square(layers=20))
    index, end = lines.index(";LAYER:7"), lines.index(";LAYER:8")
    lines_with_gap = [*lines[:index], *lines[end:]]
    relative_lines = [
        line.split(" E")[0] + " E1.6" if line.startswith("G1 F1800") else line for line in lines_with_gap
    ]
    relative_lines.insert(relative_lines.index(";LAYER:0"), "M83")
    assert "states 20 layers, but the file has only 19" in accept(relative_lines).notices[-1]


def test_block_of_settings_that_does_not_end_is_refused():
    lines = [*make_marlin(), "; prusaslicer_config = begin", "; wipe = 1", "; prusaslicer_config = end"]
    assert accept(lines).layers == 3
    assert_refused(lines[:-1], "prusaslicer_config begins in line .* and does not end")


def test_file_without_end_code_is_refused():
    lines = make_marlin(tail=[])
    assert_refused(lines, rf"line {len(lines)}: the file ends here, .*M104 S0")
    for end in ("M104 S0", "M84", "G28 X0"):
        check_rules(accept([*lines, end]))


def test_last_line_without_a_newline_is_refused():
    with pytest.raises(GcodeRefused, match="last line has no newline"):
        accept([*(line.encode() + b"\n" for line in make_marlin()[:-1]), b"M84"])


@pytest.mark.parametrize("mm_per_layer", [0.6, 8.0, 16.0])
def test_e_restarted_without_g92_is_refused_with_its_line(mm_per_layer):
    """Refuse a file whose last 40 of 100 layers would be dropped without a message."""
    lines, layers = make_marlin(make_square(side_mm=mm_per_layer / 4 / 0.0125, at_mm=20.0, layers=100)), 60
    index = lines.index(f";LAYER:{layers}")
    own_gcode = accept([*lines[:index], "G92 E0", *shift_e(lines[index:])])
    assert own_gcode.layers == 100
    assert len(select_extrusions(list_moves(extract_body(own_gcode)))) == 400
    assert_refused(
        [*lines[:index], *shift_e(lines[index:])], rf"retracted by .* mm since line {index + 3}: .*G92 E0"
    )


def shift_e(lines):
    """Shift E so that the first line begins at 0."""
    first_e = next(float(line.split("E")[1]) for line in lines if line.startswith("G1 F1800")) - 0.01
    return [
        f"{line.split('E')[0]}E{float(line.split('E')[1]) - first_e:.5f}"
        if line.startswith("G1 F1800")
        else line
        for line in lines
    ]


@pytest.mark.parametrize("line", ["G4 S90", "G1 Z-3", "G1 X50 Y50 Z0.1 F1"])
def test_mistake_after_the_last_printed_line_is_refused(line):
    assert_refused(make_marlin(tail=[line, *END_LINES]), r"line \d+: ")
    assert accept(make_marlin(tail=[*END_LINES, line])).layers == 3


def test_end_script_may_unload_the_filament():
    assert accept(make_marlin(tail=["G92 E0", "G1 E-60 F1500", *END_LINES[1:]])).layers == 3


def test_ultigcode_without_its_last_comment_is_refused():
    assert_refused(make_ultigcode()[:-1], "closes its files with a comment")
