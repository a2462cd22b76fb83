"""Stills over HTTP from cameras that answer, and from hostile ones."""

import asyncio
import hashlib
import socket

import pytest

from farm.cameras import fetch
from farm.cameras.fetch import CameraError, fetch_still
from hosts.fake_camera import make_jpeg, run_camera

SECRET = "pass-w0rd"


def fetch_image(url):
    return asyncio.run(fetch_still(url))


def send_image(request):
    request.send(make_jpeg())


def test_still_is_fetched():
    with run_camera(send_image) as camera:
        image = fetch_image(f"http://{camera.address}/shot.jpg?size=big")
    assert image.content == make_jpeg()
    path, headers = camera.requests[0]
    assert path == "/shot.jpg?size=big"
    assert (headers["host"], headers["accept-encoding"]) == (camera.address, "identity")


def test_host_name_is_looked_up_and_kept_in_the_request(monkeypatch):
    real_getaddrinfo = socket.getaddrinfo

    def look_up(host, *args, **keywords):
        return real_getaddrinfo("127.0.0.1", *args, **keywords)

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with run_camera(send_image) as camera:
        fetch_image(f"http://camera.lab.example:{camera.server_port}/")
    assert camera.requests[0][1]["host"] == f"camera.lab.example:{camera.server_port}"


def test_second_address_is_tried_when_the_first_refuses(monkeypatch):
    with run_camera(send_image) as camera:
        rows = [(None, None, 0, "", (address, camera.server_port)) for address in ("127.0.0.2", "127.0.0.1")]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: rows)
        assert fetch_image(f"http://camera.lab.example:{camera.server_port}/").content == make_jpeg()


def test_basic_authentication_is_sent_on_request():
    def send_answer(request):
        if request.headers["authorization"]:
            send_image(request)
        else:
            request.send(b"who?", 401, www_authenticate='Basic realm="camera"')

    with run_camera(send_answer) as camera:
        fetch_image(f"http://look:{SECRET}@{camera.address}/")
    assert camera.requests[1][1]["authorization"] == "Basic bG9vazpwYXNzLXcwcmQ="


def test_digest_authentication_is_sent_on_request():
    def compute_digest(text):
        return hashlib.md5(text.encode()).hexdigest()

    expected_digest = compute_digest(
        f"{compute_digest(f'look:camera:{SECRET}')}:abc:{compute_digest('GET:/shot')}"
    )

    def send_answer(request):
        if f'response="{expected_digest}"' in (request.headers["authorization"] or ""):
            send_image(request)
        else:
            request.send(b"who?", 401, www_authenticate='Digest realm="camera", nonce="abc"')

    with run_camera(send_answer) as camera:
        fetch_image(f"http://look:{SECRET}@{camera.address}/shot")


def send_endlessly(request):
    request.send_response(200)
    request.end_headers()
    request.wfile.write(make_jpeg())
    while not request.server.stopped.is_set():
        request.wfile.write(bytes(100_000))


def send_slowly(request):
    request.send_response(200)
    request.send_header("content-length", "1000")
    request.end_headers()
    request.wfile.write(make_jpeg())
    request.server.stopped.wait()


def send_half(request):
    request.send(make_jpeg(), content_length="1000")
    request.close_connection = True


def send_long_head(request):
    request.wfile.write(b"HTTP/1.1 200 OK\r\n" + b"x: y\r\n" * 100_000)


def send_endless_401(request):
    request.send_response(401)
    request.send_header("www-authenticate", 'Digest realm="r", nonce="n"')
    request.end_headers()
    while not request.server.stopped.is_set():
        request.wfile.write(bytes(100_000))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda request: request.send(b"<html>Login</html>"), "no JPEG or PNG"),
        (lambda request: request.send(make_jpeg(10_000, 10_000)), "10000 x 10000 pixels"),
        (lambda request: request.send(b"", 404), "status 404"),
        (lambda request: request.send(b"", 401, www_authenticate='Basic realm="r"'), "refuses user"),
        (lambda request: request.send(b"", 401, www_authenticate="Digest nonsense"), "not supported"),
        (lambda request: request.send(b"", 401, www_authenticate='Digest realm="r", nonce="n", algorithm=X'),
         "not supported"),
        (lambda request: request.send(b"", 302, location="http://evil.example/"), "another host"),
        (lambda request: request.send(b"", 302, location="file:///etc/passwd"), "another host"),
        (lambda request: request.send(b"", 302, location="/again"), "redirects too often"),
        (lambda request: request.send(b"", 302, location="http://[::1"), "web server"),
        (lambda request: request.wfile.write(b"SSH-2.0-OpenSSH_9\r\n"), "web server"),
        (send_endlessly, "larger than 5 MB"),
        (send_slowly, "no complete still within"),
        (send_half, "web server"),
        (send_long_head, "web server"),
        (send_endless_401, "refuses user"),
    ],
)  # fmt: skip
def test_hostile_camera_gives_an_error_without_its_address(answer, message, monkeypatch):
    monkeypatch.setattr(fetch, "FETCH_TIMEOUT_S", 5.0 if answer is not send_slowly else 0.2)
    with run_camera(answer) as camera, pytest.raises(CameraError, match=message) as error:
        fetch_image(f"http://look:{SECRET}@{camera.address}/secret-path")
    assert SECRET not in str(error.value) and "secret-path" not in str(error.value)


def test_redirect_on_the_same_host_is_followed():
    def send_answer(request):
        send_image(request) if request.path == "/new" else request.send(b"", 302, location="/new")

    with run_camera(send_answer) as camera:
        assert fetch_image(f"http://{camera.address}/old").content == make_jpeg()


def test_host_that_does_not_answer_is_an_error():
    with socket.socket() as closed_socket:
        closed_socket.bind(("127.0.0.1", 0))
        with pytest.raises(CameraError, match="connection was refused"):
            fetch_image(f"http://127.0.0.1:{closed_socket.getsockname()[1]}/")


def test_unknown_name_is_an_error(monkeypatch):
    def look_up(*_, **__):
        raise socket.gaierror("unknown")

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with pytest.raises(CameraError, match=r"camera\.lab\.example is unknown"):
        fetch_image("http://camera.lab.example/")
