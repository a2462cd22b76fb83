"""Output of `farm decompose`."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh
import typer

from farm.cli.commands import local
from farm.errors import FarmError


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "nan,nan,nan", "200,200,-1", "0,200,200", "inf,200,200"])
def test_invalid_volume_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match="three numbers above 0"):
        local.decompose(tmp_path / "none.stl", out=tmp_path, printers=2, volume=text)


def test_coupon_is_a_closed_stl_and_its_fits_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "new" / "coupon.stl"
    local.coupon(path, "3")
    assert trimesh.load_mesh(path).is_watertight
    output = capsys.readouterr().out
    assert "0.1 to 0.7 mm wider than a pin of 3 mm" in output and "11, 8, 5 and 4 mm" in output
    assert "the number that fits, in mm (4: 0.4)" in output


def test_coupon_needs_a_diameter_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(FarmError, match="--pins none"):
        local.coupon(tmp_path / "coupon.stl", "none")
    (tmp_path / "file").touch()
    with pytest.raises(FarmError, match="cannot be written"):
        local.coupon(tmp_path / "file" / "coupon.stl", "filament")
