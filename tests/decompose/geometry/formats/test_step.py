"""STEP files: boxes in mm and inches, and files that OpenCASCADE cannot read."""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from decompose.errors import ModelEmpty, ModelTooDetailed, ModelUnreadable
from decompose.geometry import load_model
from decompose.geometry.formats import step
from decompose.geometry.formats.step import read_step
from model_files.make_step import write_step_text

needs_cascadio = pytest.mark.skipif(
    importlib.util.find_spec("cascadio") is None, reason="the extra `step` is not installed"
)


@needs_cascadio
@pytest.mark.parametrize(("suffix", "unit_mm"), [("step", 1.0), ("stp", 25.4), ("STEP", 1.0)])
def test_step_file_is_read_as_a_solid_in_mm(tmp_path: Path, unit_mm: float, suffix: str) -> None:
    path = tmp_path / f"box.{suffix}"
    path.write_text(write_step_text((10, 20, 30), unit_mm))
    model = load_model(path)
    np.testing.assert_allclose(model.extents_mm, [10, 20, 30], atol=1e-4)
    assert model.solid.volume_mm3 == pytest.approx(6000, rel=1e-5)


@needs_cascadio
def test_reading_a_step_file_does_not_print(capfd: pytest.CaptureFixture[str]) -> None:
    read_step("box.step", write_step_text((10, 20, 30)).encode())
    with pytest.raises(ModelUnreadable):
        read_step("box.step", b"ISO-10303-21;\nHEADER;\njunk\nEND-ISO-10303-21;\n")
    assert capfd.readouterr() == ("", "")


@needs_cascadio
def test_invalid_step_is_refused() -> None:
    step_bytes = write_step_text((10, 20, 30)).encode()
    for data in (
        b"junk",
        step_bytes[: len(step_bytes) // 2],
        step_bytes.replace(b"CLOSED_SHELL", b"CLOSED_SHELF"),
    ):
        with pytest.raises((ModelUnreadable, ModelEmpty), match=r"box\.step: "):
            read_step("box.step", data)
    with pytest.raises(ModelTooDetailed):
        read_step("box.step", step_bytes, max_triangles=11)


def test_message_without_cascadio_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(ModelUnreadable, match=r"pip install 'farm\[step\]'"):
        read_step("box.step", write_step_text((10, 20, 30)).encode())


@pytest.mark.parametrize(("code", "expected_text"), [(-11, "crashed on it"), (0, "cannot read it")])
def test_crash_of_opencascade_is_reported_with_a_one_line_message(
    monkeypatch: pytest.MonkeyPatch, code: int, expected_text: str
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(step.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=code))
    with pytest.raises(ModelUnreadable, match=expected_text):
        read_step("box.step", write_step_text((10, 20, 30)).encode())


def test_conversion_of_an_endless_step_file_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_: object, timeout: float, **__: object) -> None:
        raise subprocess.TimeoutExpired("step", timeout)

    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(step.subprocess, "run", run)
    with pytest.raises(ModelUnreadable, match="within 300 s"):
        read_step("box.step", write_step_text((10, 20, 30)).encode())
