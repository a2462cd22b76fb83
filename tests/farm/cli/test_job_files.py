"""Fetching of a job's files: complete, under their own names, and without overwriting others."""

import hashlib
import os

import pytest

from farm import api
from farm.cli.job_files import fetch_files, is_shown_in_report
from farm.errors import FarmError, RefusedError

CONTENTS = {"p01.stl": b"solid", "plate-01.gcode": b"G28" * 1000, "assembly.png": b"\x89PNG"}


class FakeClient:
    """Client of a daemon that sends these contents, and announces the names and hashes of `files`."""

    def __init__(self, files=None, contents=None):
        self.contents = CONTENTS if contents is None else contents
        self.announced_files = self.contents if files is None else files
        self.downloads = []

    def list_files(self, number):
        rows = [
            api.FileView(name=name, size=len(content), sha256=hashlib.sha256(content).hexdigest())
            for name, content in self.announced_files.items()
        ]
        return api.JobFiles(job=number, files=rows)

    def download_file(self, number, name, write):
        self.downloads.append(name)
        content = self.contents[name]
        for start in range(0, len(content), 7):
            write(content[start : start + 7])


def read_folder(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_files_are_written_with_their_content_and_found_by_name_and_by_hash(tmp_path):
    paths = fetch_files(FakeClient(), 3, tmp_path / "new" / "folder")
    assert read_folder(tmp_path / "new" / "folder") == CONTENTS
    stored_name = hashlib.sha256(CONTENTS["p01.stl"]).hexdigest()
    assert paths.find(f"/var/lib/farm/files/{stored_name}.stl").read_bytes() == CONTENTS["p01.stl"]
    assert paths.find("/var/lib/farm/jobs/3/assembly.png").name == "assembly.png"
    assert paths.find("/etc/passwd") is None


@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o002, 0o664)])
def test_files_have_the_mode_that_the_umask_allows(tmp_path, mask, mode):
    old_mask = os.umask(mask)
    try:
        fetch_files(FakeClient(), 3, tmp_path)
        assert os.umask(mask) == mask
    finally:
        os.umask(old_mask)
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {mode}


def test_second_fetch_downloads_only_missing_files(tmp_path):
    fetch_files(FakeClient(), 3, tmp_path)
    (tmp_path / "p01.stl").unlink()
    client = FakeClient()
    assert fetch_files(client, 3, tmp_path).written_names == client.downloads == ["p01.stl"]
    assert read_folder(tmp_path) == CONTENTS


def test_own_file_is_overwritten_only_with_force(tmp_path):
    (tmp_path / "assembly.png").write_bytes(b"mine")
    client = FakeClient()
    with pytest.raises(RefusedError, match=r"assembly\.png.*--force"):
        fetch_files(client, 3, tmp_path)
    assert client.downloads == []
    assert read_folder(tmp_path) == {"assembly.png": b"mine"}
    fetch_files(client, 3, tmp_path, force=True)
    assert read_folder(tmp_path) == CONTENTS


def test_link_in_the_folder_is_replaced_and_not_followed(tmp_path):
    outside_file = tmp_path / "outside"
    outside_file.write_bytes(b"mine")
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "p01.stl").symlink_to(outside_file)
    with pytest.raises(RefusedError):
        fetch_files(FakeClient(), 3, folder)
    fetch_files(FakeClient(), 3, folder, force=True)
    assert outside_file.read_bytes() == b"mine"
    assert not (folder / "p01.stl").is_symlink()


@pytest.mark.parametrize(
    "name",
    [
        *("../p01.stl", "/etc/cron.d/x", "a/b", "..", ".", "", ".bashrc", "-rf", "a\\b", "a\0b", "a\nb"),
        *("é.stl", "x" * 200, "C:evil"),
    ],
)
def test_unsafe_file_name_is_refused_and_nothing_is_written(tmp_path, name):
    folder = tmp_path / "folder"
    with pytest.raises(FarmError, match="not valid"):
        fetch_files(FakeClient({"p01.stl": b"solid", name: b"evil"}), 3, folder)
    assert not folder.exists()


@pytest.mark.parametrize("sent_content", [b"", b"soli", b"SOLID", b"solid and more"])
def test_damaged_content_leaves_no_file(tmp_path, sent_content):
    with pytest.raises(FarmError, match=r"p01\.stl"):
        fetch_files(FakeClient({"p01.stl": b"solid"}, {"p01.stl": sent_content}), 3, tmp_path)
    assert read_folder(tmp_path) == {}


def test_lost_connection_keeps_only_complete_files(tmp_path):
    class DisconnectingClient(FakeClient):
        def download_file(self, number, name, write):
            if self.downloads:
                write(b"G28")
                raise FarmError("no daemon answers")
            super().download_file(number, name, write)

    with pytest.raises(FarmError, match="no daemon"):
        fetch_files(DisconnectingClient(), 3, tmp_path)
    assert read_folder(tmp_path) == {"p01.stl": CONTENTS["p01.stl"]}


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(FarmError, match="--out"):
        fetch_files(FakeClient(), 3, tmp_path / "file" / "folder")


def test_report_fetches_only_pictures_and_parts(tmp_path):
    fetch_files(FakeClient(), 3, tmp_path, select=is_shown_in_report)
    assert sorted(read_folder(tmp_path)) == ["assembly.png", "p01.stl"]
