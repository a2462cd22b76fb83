"""Summary of a decomposition on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from farm.cli.display.decomposition import summarise_decomposition


def make_report(**options: Any) -> dict[str, Any]:
    parts = [{"id": f"p0{i}", "file": f"p0{i}.stl", "stands": True} for i in range(1, 4)]
    return {
        "engine": "guillotine",
        "cells": [3, 4, 5],
        "parts": parts,
        "makespan_s": 3600.0,
        "serial_s": 9000.0,
        "serial_as_is_s": 10800.0,
        "lower_bound_s": 3300.0,
        "gap": 0.083,
        "repairs": [],
        "joints": [
            {"a": "p01", "b": "p02", "area_mm2": 120.4, "width_mm": 8.04, "glued": True},
            {"a": "p02", "b": "p03", "area_mm2": 900.0, "width_mm": 30.0, "glued": True},
            {"a": "p01", "b": "p03", "area_mm2": 4.0, "width_mm": 1.0, "glued": False},
        ],
        "faults": [],
        "yaw_deg": 0.0,
        "seam_mm": 812.4,
        "thin_rims": "",
        "small_feet": "",
        "options": {"pin_mm": None},
        "connectors": {"pins": [], "cut_list": [], "failures": []},
        "assembly": {"steps": [{}, {}], "estimated_s": 1860.0},
    } | options


def test_summary_lists_the_pins_to_cut_and_parts_that_were_not_drilled() -> None:
    connectors = {
        "pins": [{}] * 3,
        "cut_list": [{"length_mm": 13.0, "count": 1}, {"length_mm": 7.0, "count": 2}],
        "failures": ["p02 has no holes and marks: it is no longer one piece (rule drilled)"],
    }
    lines = summarise_decomposition(
        make_report(connectors=connectors, options={"pin_mm": 2.85}), 4, Path("out")
    )
    assert "3 pins of 2.85 mm: cut 1 of 13 mm, 2 of 7 mm" in lines
    assert "Check: p02 has no holes and marks: it is no longer one piece (rule drilled)" in lines


def test_summary_of_a_good_result_has_five_lines() -> None:
    assert summarise_decomposition(make_report(), 4, Path("out")) == [
        "3 parts: 1h00 on 4 printers; uncut on a large one: 2h30 in the best pose, 3h00 as in the file "
        "(efficiency E 0.75)",
        "By guillotine: at most 8% above the least makespan with cuts along its grid",
        "2 joints; the smallest, p01 to p02, has 120 mm2 of glue area and is 8.0 mm wide",
        "2 steps of assembly, about 31 min; 812 mm of joint lines on the outside",
        "In out: p01.stl to p03.stl, assembly.png, assembly.glb, decomposition.json, instructions.html",
    ]


def test_turned_cuts_are_reported() -> None:
    (_, message, *_) = summarise_decomposition(make_report(yaw_deg=15.0), 4, Path("out"))
    assert message.startswith("By guillotine, turned by 15 degrees about Z: at most 8%")


def test_summary_has_at_most_seven_lines() -> None:
    parts = [{"id": f"p0{i}", "file": f"p0{i}.stl", "stands": i == 1} for i in range(1, 7)]
    fault = {"part": "p03", "what": "is 5.0 mm thick where it was cut, less than 8 mm"}
    lines = summarise_decomposition(
        make_report(repairs=["Closed it.", "Turned it."], faults=[fault], parts=parts), 4, Path("out")
    )
    assert len(lines) == 7
    assert lines[0] == "Closed it. Turned it."
    assert lines[5] == (
        "Check: p03 is 5.0 mm thick where it was cut, less than 8 mm; "
        "p02 may fall over while it is printed; p03 may fall over while it is printed, and 3 more"
    )


def test_two_parts_have_one_joint() -> None:
    (_, _, joint, *_) = summarise_decomposition(
        make_report(joints=make_report()["joints"][1:]), 4, Path("out")
    )
    assert joint == "1 joint; the smallest, p02 to p03, has 900 mm2 of glue area and is 30.0 mm wide"


def test_one_part_has_no_joint() -> None:
    lines = summarise_decomposition(
        make_report(
            parts=make_report()["parts"][:1],
            joints=[],
            cells=None,
            assembly={"steps": [], "estimated_s": 0.0},
        ),
        1,
        Path("out"),
    )
    assert [line.split()[0] for line in lines] == ["1", "By", "In"]
    assert lines[0].startswith("1 part: 1h00 on 1 printer; ")
    assert lines[2] == "In out: p01.stl, assembly.png, assembly.glb, decomposition.json, instructions.html"
