"""Farm on the network, used from another host: real daemon, real TLS, real keys."""

import json
import os
import signal
import socket
import ssl
import subprocess
import urllib.error
import urllib.request
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
import trimesh

from bench.web.load import list_incomplete_requests
from farms.real_farm import RealFarm, find_free_port, wait_for

pytestmark = pytest.mark.system
INCOMPLETE_HEAD = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"


def make_certificate(folder):
    """Make a certificate for localhost with openssl."""
    cert, key = folder / "cert.pem", folder / "key.pem"
    names = "subjectAltName=DNS:localhost,IP:127.0.0.1"
    request = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost"]
    subprocess.run(
        [*request, "-addext", names, "-keyout", key, "-out", cert, "-days", "2"],
        check=True,
        capture_output=True,
    )
    return cert, key


def request_page(port, path, context=None, key=None):
    """Return the status of a request, and its answer."""
    scheme = "http" if context is None else "https"
    request = urllib.request.Request(f"{scheme}://localhost:{port}{path}")
    if key:
        request.add_header("Authorization", f"Bearer {key}")
    try:
        with urllib.request.urlopen(request, timeout=30, context=context) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


class RedirectKeeper(urllib.request.HTTPRedirectHandler):
    """Handler that returns a redirection instead of following it."""

    def redirect_request(self, *_):
        return None


def open_session(link, origin, context):
    """Log in with a link; return the session cookie."""
    opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=context), RedirectKeeper)
    request = urllib.request.Request(link, method="POST", data=b"", headers={"Origin": origin})
    with pytest.raises(urllib.error.HTTPError, match="303") as error:
        opener.open(request, timeout=30)
    with error.value as answer:
        return answer.headers["Set-Cookie"].partition(";")[0]


@pytest.fixture
def farm(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    yield farm
    farm.end()


def test_another_host_sees_and_submits_over_tls_as_its_role_allows(farm, tmp_path):
    port = find_free_port()
    cert, key = make_certificate(tmp_path)
    farm.fleet.write_text(
        farm.fleet.read_text() + f"web: {{listen: '0.0.0.0:{port}', tls: {{cert: {cert}, key: {key}}}}}\n"
    )
    farm.up()
    assert "there is no key yet" in farm.run_checked("key")
    with closing(socket.socket()) as probe:  # the server does not listen before there is a key
        assert probe.connect_ex(("127.0.0.1", port)) != 0
    added_key = farm.run_checked("key", "add", "laptop", "--role", "look").strip()
    context = ssl.create_default_context(cafile=cert)
    wait_for("the server", lambda: "closed" not in farm.run_checked("key").splitlines()[0])
    assert request_page(port, "/healthz", context) == (200, b'{"status":"ok"}')
    assert request_page(port, "/api/v1/status", context)[0] == 401
    assert request_page(port, "/status", context, added_key)[0] == 404

    file = tmp_path / "key"
    file.touch(mode=0o600)
    file.write_text(added_key + "\n")
    url = f"https://localhost:{port}"
    environment = {"FARM_URL": url, "FARM_KEY_FILE": str(file), "SSL_CERT_FILE": str(cert)}
    assert json.loads(farm.run_checked("status", "--json", **environment))["printers"][0]["name"] == "um2-01"
    result = farm.run("cleared", "um2-01", **environment)
    assert (result.returncode, "needs a key with the role operate; laptop has look" in result.stderr) == (
        5,
        True,
    )

    file.write_text(farm.run_checked("key", "add", "ann", "--role", "print").strip())
    model = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 20.0, 5.0)).export(model)
    answer = json.loads(farm.run_checked("submit", model, "--json", **environment))
    assert answer["job"]["submitted_by"] == "key ann"
    file.chmod(0o644)
    assert "chmod 600" in farm.run("status", **environment).stderr
    listed_keys = json.loads(farm.run_checked("key", "--json"))["keys"]
    assert [(listed_key["name"], listed_key["used"] is not None) for listed_key in listed_keys] == [
        ("laptop", True),
        ("ann", True),
    ]
    link = json.loads(farm.run_checked("web", "--json"))
    assert link["url"].startswith(f"https://{socket.gethostname()}:{port}/login/")
    session = open_session(url + "/login/" + link["url"].rpartition("/")[2], url, context)
    assert session.startswith(f"__Host-farm-{port}=session_")
    page = urllib.request.Request(url, headers={"Cookie": session})
    with urllib.request.urlopen(page, timeout=30, context=context) as response:
        assert f"{link['user']} (operate)" in response.read().decode()
    assert farm.run_checked("web", "--end-all") == "1 session ended\n"
    with pytest.raises(urllib.error.HTTPError, match="401") as error:
        urllib.request.urlopen(page, timeout=30, context=context)
    error.value.close()
    farm.run_checked("key", "revoke", listed_keys[0]["id"])
    assert request_page(port, "/api/v1/status", context, added_key)[0] == 401
    # A client that never begins its handshake does not delay others.
    with ExitStack() as idle_clients:
        for _ in range(100):
            idle_clients.enter_context(socket.create_connection(("127.0.0.1", port), 30))
        assert request_page(port, "/healthz", context)[0] == 200


def test_slow_network_clients_do_not_delay_the_socket(farm):
    with closing(socket.create_server(("127.0.0.1", 0))) as other_listener:
        port = other_listener.getsockname()[1]
        farm.fleet.write_text(farm.fleet.read_text() + f"web: {{listen: '127.0.0.1:{port}'}}\n")
        farm.up()
        assert "Address already in use" in farm.run_checked("key")
    wait_for("the port", lambda: "closed" not in farm.run_checked("key").splitlines()[0])
    with ExitStack() as idle_clients:
        for number in range(300):
            client = idle_clients.enter_context(socket.create_connection(("127.0.0.1", port), 30))
            if number % 2:
                client.send(INCOMPLETE_HEAD)
        assert farm.read_status()["printers"][0]["state"] == "idle"
        assert request_page(port, "/healthz")[0] == 200
    pid = farm.read_status()["daemon"]["pid"]
    os.kill(pid, signal.SIGTERM)
    wait_for("the daemon's end", lambda: not (farm.state / "farm.sock").exists(), 30.0)


def test_daemon_ends_in_time_with_hanging_clients_and_incomplete_uploads(farm, tmp_path):
    port = find_free_port()
    farm.fleet.write_text(farm.fleet.read_text() + f"web: {{listen: '127.0.0.1:{port}'}}\n")
    farm.up()
    key = farm.run_checked("key", "add", "ann", "--role", "print").strip()
    incomplete_requests = list_incomplete_requests(key)
    with ExitStack() as stack:
        for number in range(150):
            client = stack.enter_context(socket.create_connection(("127.0.0.1", port), 30))
            client.send(incomplete_requests[number % len(incomplete_requests)])
        status = farm.read_status()
        agent = status["printers"][0]["agent_pid"]
        wait_for("half an upload", lambda: list((farm.state / "work").glob("upload-*")), 60.0)
        os.kill(status["daemon"]["pid"], signal.SIGTERM)
        # The code after both servers removes the socket.
        wait_for("the daemon's end", lambda: not (farm.state / "farm.sock").exists(), 60.0)
        wait_for("its process's end", lambda: not is_running(status["daemon"]["pid"]), 60.0)
    assert not list((farm.state / "work").glob("upload-*"))
    assert is_running(agent)
    farm.up()
    assert farm.read_status()["printers"][0]["agent_pid"] == agent


def is_running(pid):
    """Check whether a process runs and is not a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
