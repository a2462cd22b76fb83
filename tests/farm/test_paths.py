"""Paths of a farm: options, then environment, then XDG folders."""

import os
import stat
from pathlib import Path

import pytest

from farm.errors import RefusedError
from farm.paths import StateFolder, find_farm_paths, read_anchor, write_anchor


def test_options_precede_environment_and_xdg_folders(tmp_path):
    env = {"HOME": "/home/ann", "XDG_RUNTIME_DIR": "/run/user/7"}
    paths = find_farm_paths(None, None, None, env)
    assert paths.state.root == Path("/home/ann/.local/state/farm")
    assert paths.socket == Path("/run/user/7/farm/farm.sock")
    env |= {"FARM_STATE": "/srv/farm", "FARM_FLEET": "/srv/fleet.yaml"}
    paths = find_farm_paths(None, None, None, env)
    assert (paths.state.root, paths.fleet) == (Path("/srv/farm"), Path("/srv/fleet.yaml"))
    assert find_farm_paths(Path("/tmp/x"), None, Path("f.yaml"), env).state.root == Path("/tmp/x")


def test_two_state_folders_never_share_a_socket():
    env = {"HOME": "/home/ann", "XDG_RUNTIME_DIR": "/run/user/7"}
    sockets = {find_farm_paths(Path(folder), None, None, env).socket for folder in ("/a", "/b")}
    assert sockets == {Path("/a/farm.sock"), Path("/b/farm.sock")}


def test_long_socket_path_is_replaced_by_a_short_one():
    env = {"HOME": "/home/ann", "XDG_RUNTIME_DIR": "/run/user/7"}
    deep_folders = [Path("/" + letter * 120) for letter in "ab"]
    sockets = [find_farm_paths(folder, None, None, env).socket for folder in deep_folders]
    assert sockets[0] != sockets[1]
    assert all(len(str(socket)) < 100 for socket in sockets)
    assert find_farm_paths(deep_folders[0], None, None, env).socket == sockets[0]


@pytest.fixture
def temporary_folder(tmp_path, monkeypatch):
    """Return the folder for temporary files, and a function that finds the short path of a socket."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / f"farm-{os.getuid()}"
    return folder, lambda: find_farm_paths(Path("/" + "a" * 120), None, None, {"HOME": "/home/ann"}).socket


def test_socket_of_a_long_path_is_in_a_private_folder(temporary_folder):
    folder, find_socket = temporary_folder
    assert find_socket().parent == folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert find_socket().parent == folder  # the folder exists now


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [
        (lambda folder: folder.mkdir(mode=0o755), "is open to other users .mode 755."),
        (lambda folder: folder.mkdir(mode=0o710), "is open to other users .mode 710."),
        (lambda folder: folder.symlink_to(folder.parent), "is not a folder"),
        (lambda folder: folder.touch(), "cannot be used"),
    ],
)
def test_temporary_folder_open_to_others_is_refused(temporary_folder, prepare, reason):
    folder, find_socket = temporary_folder
    prepare(folder)
    with pytest.raises(RefusedError, match=f"{folder} {reason}.*name a shorter --socket"):
        find_socket()


def test_temporary_folder_of_another_user_is_refused(temporary_folder, monkeypatch):
    folder, find_socket = temporary_folder
    find_socket()
    own_uid = os.getuid()
    monkeypatch.setattr("os.getuid", lambda: own_uid + 1)
    folder.rename(folder.with_name(f"farm-{own_uid + 1}"))
    with pytest.raises(RefusedError, match="belongs to another user"):
        find_socket()


def test_user_without_a_farm_uses_the_shared_one(tmp_path):
    env = {"HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path / "run")}
    shared_socket = tmp_path / "shared" / "farm.sock"
    own_socket = tmp_path / "run" / "farm" / "farm.sock"
    assert find_farm_paths(None, None, None, env, shared_socket).socket == own_socket
    shared_socket.parent.mkdir()
    assert find_farm_paths(None, None, None, env, shared_socket).socket == shared_socket
    assert find_farm_paths(tmp_path, None, None, env, shared_socket).socket == tmp_path / "farm.sock"
    own_socket.parent.mkdir(parents=True)
    own_socket.touch()
    assert find_farm_paths(None, None, None, env, shared_socket).socket == own_socket


def test_inaccessible_folders_are_skipped(tmp_path, monkeypatch):
    """Skip folders of another user: `su` keeps the caller's XDG_RUNTIME_DIR and working folder."""
    env = {"HOME": str(tmp_path), "XDG_RUNTIME_DIR": "/run/user/0", "XDG_CONFIG_HOME": "/root/.config"}

    def refuse_access(path):
        if not path.is_relative_to("/opt"):
            raise PermissionError(13, "Permission denied", str(path))
        return True

    for check in ("exists", "is_file", "is_dir"):
        monkeypatch.setattr(Path, check, refuse_access)
    paths = find_farm_paths(None, None, None, env, Path("/opt/run/farm.sock"))
    assert (paths.socket, paths.fleet.name) == (Path("/opt/run/farm.sock"), "fleet.yaml")


def test_fleet_file_in_the_current_folder_is_preferred(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "config" / "farm" / "fleet.yaml"
    config.parent.mkdir(parents=True)
    config.touch()
    env = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "config")}
    assert find_farm_paths(None, None, None, env).fleet == config
    (tmp_path / "fleet.yaml").touch()
    assert find_farm_paths(None, None, None, env).fleet == tmp_path / "fleet.yaml"


def test_clock_anchor_is_written_atomically(tmp_path):
    path = tmp_path / "clock.json"
    assert read_anchor(path) is None
    write_anchor(path, 60.0, 1.7e9)
    assert read_anchor(path) == (60.0, 1.7e9)
    path.write_text("{")
    assert read_anchor(path) is None


def test_state_folder_keeps_its_clock(tmp_path):
    from farm.config import Fleet
    from farm.daemon import open_farm_clock

    def make_fleet(scale):
        printer = {"name": "a", "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus"}
        return Fleet.model_validate({"fleet": {"time_scale": scale}, "printers": [printer]})

    first_clock = open_farm_clock(make_fleet(60), StateFolder(tmp_path))
    assert open_farm_clock(make_fleet(60), StateFolder(tmp_path)) == first_clock
    with pytest.raises(RefusedError, match="time_scale 60, not 1"):
        open_farm_clock(make_fleet(1), StateFolder(tmp_path))
