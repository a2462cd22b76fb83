"""What the daemon says where it cannot begin."""

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
