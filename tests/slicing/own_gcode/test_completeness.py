"""Completeness of own G-code: truncated files, and missing layers."""

import gzip
import json
import re
from functools import cache
from pathlib import Path

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from make_gcode import END, FILAMENT_MM2, marlin, square, ultigcode
from own_gcode import body, fed, followed, refused, safe, take
from slicing.errors import GcodeRefused
from slicing.own_gcode.survey import survey_lines

FIXTURES = Path(__file__).parents[1] / "fixtures"
COUNTED = [";LAYER_COUNT:100", *marlin(square(layers=100))]


def cura_settings():
    """Format the settings that Cura appends to the engine's G-code: escaped JSON, in lines of 80."""
    profile = "[general]\\nversion = 4\\nname = draft \\\\ fine\\n\\n[values]\\nadhesion_type = brim\\n"
    text = json.dumps({"global_quality": profile, "extruder_quality": [profile]})
    text = text.replace("\\", "\\\\").replace("\n", "\\n")
    return "".join(f";SETTING_3 {text[at : at + 68]}\n" for at in range(0, len(text), 68)).encode()


@cache
def write_complete(slicer):
    """A file as a slicer wrote it on the tile, or the plate, of the fixtures."""
    if slicer == "cura 5":
        record = json.loads(gzip.decompress((FIXTURES / "engine-5.0.json.gz").read_bytes()))
        return record["gcode"].encode()
    if slicer == "cura and its settings":
        return write_complete("ultigcode") + cura_settings()
    return gzip.decompress((FIXTURES / f"tile-{slicer}.gcode.gz").read_bytes())


SLICERS = ["ultigcode", "cura 5", "cura and its settings", "prusaslicer"]


@pytest.mark.parametrize("slicer", [*SLICERS, "slic3r"])
def test_complete_file_is_accepted(slicer):
    safe(take(write_complete(slicer).splitlines(keepends=True)))


def cut_is_refused(file, at):
    assume(file[:at] != write_complete("ultigcode"))  # a whole file, to which Cura adds its settings
    with pytest.raises(GcodeRefused, match=r"line \d+|prints nothing|start of its print|its flavour"):
        take(file[:at].splitlines(keepends=True))


@pytest.mark.parametrize("slicer", SLICERS)
@given(share=st.floats(0, 1, exclude_max=True))
@example(share=0.9999999)
@settings(max_examples=60, deadline=None)
def test_file_cut_at_any_byte_is_refused(slicer, share):
    file = write_complete(slicer)
    cut_is_refused(file, int(share * len(file)))


@pytest.mark.parametrize("slicer", SLICERS)
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_file_cut_at_the_end_of_any_line_is_refused(slicer, data):
    file = write_complete(slicer)
    ends = [result.end() for result in re.finditer(rb"\n", file)]
    cut_is_refused(file, data.draw(st.sampled_from(ends[:-1])))


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_file_of_a_slicer_without_a_closing_mark_is_refused_before_its_end_code(data):
    """Slic3r closes with its settings; a file of an unknown slicer has only its end code."""
    slic3r, unknown = write_complete("slic3r"), "\n".join(marlin(square(layers=20))).encode() + b"\n"
    for file, end in ((slic3r, b"; filament used"), (unknown, b"M104 S0")):
        ends = [result.end() for result in re.finditer(rb"\n", file[: file.index(end)])]
        cut_is_refused(file, data.draw(st.sampled_from(ends)))
        cut_is_refused(file, data.draw(st.sampled_from(ends)) - data.draw(st.integers(1, 2)))


def test_fewer_layers_than_the_file_names_are_refused():
    assert take(COUNTED).layers == 100
    refused([line for line in COUNTED if line != ";LAYER:99"], "line 1 names 100 layers, and 99 of them")
    at = COUNTED.index(";LAYER:60")
    refused([*COUNTED[:at], *END], rf"line {at + len(END)}: .* line 1 names 100 layers, and 60 of them")


@pytest.mark.parametrize(
    "count",
    ["; total layers count = 100", "; total layer number: 100", ";Layer count: 100", ";LAYER_COUNT:100"],
)
def test_count_of_each_slicer_is_known(count):
    lines = [line.replace(";LAYER:", ";LAYER_CHANGE ") for line in marlin(square(layers=60))]
    refused([*lines, count], "names 100 layers, and 60 of them")
    assert take([*lines, count.replace("100", "60")]).layers == 60


def test_layers_of_sequential_objects_are_counted_per_object():
    first, second = square(layers=3), square(at_mm=170.0, layers=3)
    lines = marlin([*first, *second])
    for number in (3, 4, 5):
        lines[lines.index(f";LAYER:{number}")] = f";LAYER:{number - 3}"
    ends = [n for n, line in enumerate(lines) if line == ";LAYER:0"]
    for at in reversed(ends):
        lines.insert(at, ";LAYER_COUNT:3")
    assert take(lines).layers == 6
    refused([line.replace("COUNT:3", "COUNT:5") for line in lines], "names 5 layers, and 3 of them")


def test_empty_layers_that_cura_omits_are_a_warning():
    """Empty layers in the tip of a spire are accepted if the closing comment is present."""
    lines = ultigcode(square(layers=20))
    counted = [line.replace("COUNT:20", "COUNT:24") for line in lines]
    assert "names 24 layers, and 20 of them are in it: Cura" in take(counted).notices[-1]
    assert not any("layers" in line for line in take(lines).notices)
    refused(counted[:-1], "closes its files with a comment")
    refused([line.replace("COUNT:20", "COUNT:30") for line in lines], "names 30 layers, and 20 of them")


@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_file_with_missing_layers_and_an_intact_end_is_refused(data):
    """Missing filament would be extruded in one move; only the count reveals missing last layers."""
    lines = write_complete("ultigcode").splitlines(keepends=True)
    starts = [at for at, line in enumerate(lines) if line.startswith(b";LAYER:")]
    last = max(at for at, line in enumerate(lines) if line.startswith(b";TIME_ELAPSED:")) + 1
    starts.append(last)
    first = data.draw(st.integers(1, len(starts) - 2))
    lost = data.draw(st.integers(first + 1, len(starts) - 1))
    hole = lines[: starts[first]] + lines[starts[lost] :]
    if lost < len(starts) - 1:
        with pytest.raises(GcodeRefused, match=r"lines are missing|names .* layers"):
            take(hole)
        return
    try:
        assert "layers, and" in take(hole).notices[-1]
    except GcodeRefused as refusal:
        assert re.search("lines are missing|names .* layers", str(refusal))


def with_figures(slicer):
    """A file with the figures that its slicer knows at the end, which Cura writes into its head."""
    if slicer == "cura 5":
        record = json.loads(gzip.decompress((FIXTURES / "engine-5.0.json.gz").read_bytes()))
        [head] = re.findall(
            r"Gcode header after slicing:\n(.*?)\n+End of gcode header", record["log"], re.DOTALL
        )
        return head.encode() + write_complete(slicer)[write_complete(slicer).index(b"\n\n;Generated") :]
    if slicer == "ultigcode":
        return write_complete(slicer).replace(b":6666\n;MATERIAL:6666", b":105\n;MATERIAL:246")
    return write_complete(slicer)


@pytest.mark.parametrize("slicer", ["cura 5", "ultigcode", "prusaslicer", "slic3r"])
def test_filament_that_a_slicer_names_is_in_its_file(slicer):
    lines = with_figures(slicer).splitlines(keepends=True)
    assert survey_lines(lines, 2.85).figures.filament is not None
    safe(take(lines))


@pytest.mark.parametrize("slicer", ["cura 5", "ultigcode", "prusaslicer"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_file_with_stated_filament_is_refused_if_any_layer_is_missing(slicer, data):
    """Includes the last layers, and files with relative E."""
    lines = with_figures(slicer).splitlines(keepends=True)
    starts = [at for at, line in enumerate(lines) if line.startswith((b";LAYER:", b";LAYER_CHANGE"))]
    starts.append(max(at for at, line in enumerate(lines) if line.startswith(b"G1 X") and b"E" in line) + 1)
    first = data.draw(st.integers(0, len(starts) - 2))
    last = data.draw(st.integers(first + 1, len(starts) - 1))
    with pytest.raises(GcodeRefused):
        take(lines[: starts[first] + 1] + lines[starts[last] :])


def test_empty_layers_are_accepted_if_all_filament_is_present():
    message = [line.replace("COUNT:20", "COUNT:40") for line in ultigcode(square(layers=20))]
    refused(message, "names 40 layers")
    volume = round(take(ultigcode(square(layers=20))).filament_mm * FILAMENT_MM2)
    figures = [line.replace("TIME:6666", "TIME:60").replace(":6666", f":{volume}") for line in message]
    assert not any("layers" in line for line in take(figures).notices)
    more = [line.replace(f":{volume}", f":{volume + 2}") for line in figures]
    refused(more, rf"line 3 says that it takes {volume + 2} mm3 of filament, and {volume}")
    flow = [*more[:-6], "M221 S101", *more[-6:]]  # more than its E says: there is nothing to compare
    refused(flow, "names 40 layers")
    assert take([line.replace("COUNT:40", "COUNT:20") for line in flow]).layers == 20


def test_filament_for_lines_that_are_missing_is_refused_with_the_line():
    lines = marlin(square(layers=100))
    at, to = lines.index(";LAYER:40"), lines.index(";LAYER:45")
    refused([*lines[:at], *lines[to:]], rf"line {at + 3}: one move feeds .* lines are missing before it")


def test_missing_layer_is_reported_with_relative_e():
    """An empty layer that was omitted cannot be told from one that was lost."""
    lines = ultigcode(square(layers=20))
    at, to = lines.index(";LAYER:7"), lines.index(";LAYER:8")
    gap = [*lines[:at], *lines[to:]]
    relative = [line.split(" E")[0] + " E1.6" if line.startswith("G1 F1800") else line for line in gap]
    relative.insert(relative.index(";LAYER:0"), "M83")
    assert "names 20 layers, and 19 of them are in it" in take(relative).notices[-1]


def test_block_of_settings_that_does_not_end_is_refused():
    lines = [*marlin(), "; prusaslicer_config = begin", "; wipe = 1", "; prusaslicer_config = end"]
    assert take(lines).layers == 3
    refused(lines[:-1], "prusaslicer_config begins in line .* and does not end")


def test_file_without_end_code_is_refused():
    lines = marlin(tail=[])
    refused(lines, rf"line {len(lines)}: the file ends here, .*M104 S0")
    for end in ("M104 S0", "M84", "G28 X0"):
        safe(take([*lines, end]))


def test_last_line_without_a_newline_is_refused():
    with pytest.raises(GcodeRefused, match="last line has no newline"):
        take([*(line.encode() + b"\n" for line in marlin()[:-1]), b"M84"])


@pytest.mark.parametrize("mm_a_layer", [0.6, 8.0, 16.0])
def test_e_restarted_without_g92_is_refused_with_its_line(mm_a_layer):
    """The last 40 of 100 layers were dropped without a message."""
    lines, layers = marlin(square(side_mm=mm_a_layer / 4 / 0.0125, at_mm=20.0, layers=100)), 60
    at = lines.index(f";LAYER:{layers}")
    message = take([*lines[:at], "G92 E0", *renumbered(lines[at:])])
    assert message.layers == 100
    assert len(fed(followed(body(message)))) == 400
    refused([*lines[:at], *renumbered(lines[at:])], rf"retracted by .* mm since line {at + 3}: .*G92 E0")


def renumbered(lines):
    """Shift E so that the first line begins at 0."""
    first = next(float(line.split("E")[1]) for line in lines if line.startswith("G1 F1800")) - 0.01
    return [
        f"{line.split('E')[0]}E{float(line.split('E')[1]) - first:.5f}"
        if line.startswith("G1 F1800")
        else line
        for line in lines
    ]


@pytest.mark.parametrize("line", ["G4 S90", "G1 Z-3", "G1 X50 Y50 Z0.1 F1"])
def test_mistake_after_the_last_printed_line_is_refused(line):
    refused(marlin(tail=[line, *END]), r"line \d+: ")
    assert take(marlin(tail=[*END, line])).layers == 3


def test_end_script_may_unload_the_filament():
    assert take(marlin(tail=["G92 E0", "G1 E-60 F1500", *END[1:]])).layers == 3


def test_ultigcode_without_its_last_comment_is_refused():
    refused(ultigcode()[:-1], "closes its files with a comment")
