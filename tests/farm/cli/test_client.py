"""What a person is told where the daemon says nothing."""

import httpx
import pytest

from farm.cli.client import Client
from farm.errors import DaemonUnreachable


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (httpx.ConnectError("refused"), "`farm up` starts one"),
        (httpx.ReadTimeout("timed out"), "what was asked may still be done"),
    ],
)
def test_a_daemon_that_is_late_is_not_taken_for_one_that_is_not_there(tmp_path, trouble, said):
    def answer(request):
        raise trouble

    client = Client(tmp_path / "farm.sock")
    client._http = httpx.Client(transport=httpx.MockTransport(answer), base_url="http://farm")
    with pytest.raises(DaemonUnreachable, match=said):
        client.status()
