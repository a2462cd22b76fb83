"""Cache of machine code, valid until a compiled file changes, even if the source folder is not writable."""

from __future__ import annotations

from pathlib import Path

import pytest

from decompose import jit
from decompose.jit import find_code_folder, hash_sources


def test_change_in_any_compiled_file_is_detected(tmp_path: Path) -> None:
    cost, boxes, text = (tmp_path / name for name in ("cost.py", "boxes.py", "words.py"))
    cost.write_text("from decompose.jit import jit\nPRICE = 1.0\n")
    boxes.write_text("from decompose.jit import jit\nfrom decompose.cost import PRICE\n")
    text.write_text("TEXT = 'not compiled'\n")
    old_hash = hash_sources(tmp_path)
    text.write_text("TEXT = 'changed'\n")
    assert hash_sources(tmp_path) == old_hash
    cost.write_text("from decompose.jit import jit\nPRICE = 2.0\n")
    assert hash_sources(tmp_path) != old_hash


@pytest.fixture
def unwritable_folders(monkeypatch: pytest.MonkeyPatch) -> set[Path]:
    """Make folders unwritable, even if the tests run as root."""
    folders: set[Path] = set()
    is_writable = jit.is_writable
    monkeypatch.setattr(jit, "is_writable", lambda folder: folder not in folders and is_writable(folder))
    return folders


def test_code_is_stored_beside_writable_sources(tmp_path: Path) -> None:
    assert find_code_folder(tmp_path / "installed", [tmp_path / "own"]) == tmp_path / "installed"
    assert not (tmp_path / "own").exists()


def test_installed_code_is_copied_for_a_user_who_may_not_write_it(
    tmp_path: Path, unwritable_folders: set[Path]
) -> None:
    installed_folder, own_folder = tmp_path / "installed", tmp_path / "home" / "own"
    (installed_folder / "grid").mkdir(parents=True)
    (installed_folder / "grid" / "boxes.nbc").write_bytes(b"code")
    unwritable_folders.add(installed_folder)
    assert find_code_folder(installed_folder, [own_folder]) == own_folder
    assert (own_folder / "grid" / "boxes.nbc").read_bytes() == b"code"
    assert [path.name for path in own_folder.parent.iterdir()] == ["own"]
    (own_folder / "grid" / "rays.nbc").write_bytes(b"more")
    find_code_folder(installed_folder, [own_folder])
    assert (own_folder / "grid" / "rays.nbc").exists()  # it is not copied again


def test_unwritable_home_falls_back_to_a_temporary_folder(
    tmp_path: Path, unwritable_folders: set[Path]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    unwritable_folders.add(tmp_path / "installed")
    other_folders = [tmp_path / "file" / "own", tmp_path / "scratch"]
    assert find_code_folder(tmp_path / "installed", other_folders) == tmp_path / "scratch"
    assert find_code_folder(tmp_path / "installed", other_folders[:1]) is None
