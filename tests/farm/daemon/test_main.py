"""What the daemon says where it cannot begin."""

import subprocess
import sys

import pytest

from farm.daemon.main import run
from farm.errors import FarmError
from farm.paths import Places, StateFolder
from one_core import fleet


def test_a_state_folder_that_cannot_be_written_is_named_in_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr("logging.basicConfig", lambda **_: None)
    state = StateFolder(tmp_path / "state")
    state.make()
    state.lock.mkdir()  # as a full disk or a read-only one does, it takes no lock
    with pytest.raises(FarmError, match=r"state folder .* cannot be used .*: has its disk room"):
        run(fleet(), Places(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))


@pytest.mark.parametrize("module", ["farm.daemon.main", "farm.services.work", "farm.cli.main"])
def test_what_only_workers_need_is_not_loaded_by_those_who_wait_for_nothing(module):
    """A restarted daemon, and every `farm status`, has to be up at once."""
    slow = ("numpy", "scipy", "trimesh", "numba", "sklearn", "matplotlib", "shapely", "manifold3d", "httpx")
    script = f"import sys, {module}; print([m for m in {slow} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
