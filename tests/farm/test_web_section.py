"""Keys under `web` in fleet.yaml: addresses for browsers."""

import pytest
from pydantic import ValidationError

from farm.config import WebSection
from farm.web import find_host_names

TLS = {"cert": "c.pem", "key": "k.pem"}


@pytest.mark.parametrize(
    ("keys", "url", "is_encrypted"),
    [
        ({}, "http://127.0.0.1:8467", False),
        ({"listen": "0.0.0.0:80"}, "http://pc-b:80", False),
        ({"listen": "[::]:80", "tls": TLS}, "https://pc-b:80", True),
        ({"listen": "10.0.0.7:80"}, "http://10.0.0.7:80", False),
        ({"listen": "[fd00::1]:80"}, "http://[fd00::1]:80", False),
        ({"listen": "0.0.0.0:80", "names": ["Farm.lab"], "tls": TLS}, "https://farm.lab:80", True),
        ({"names": ["farm.lab"]}, "http://127.0.0.1:8467", False),
        ({"url": "https://Farm.lab/"}, "https://farm.lab", True),
        ({"url": "http://farm.lab:81", "tls": TLS}, "http://farm.lab:81", False),
    ],
)
def test_url_for_browsers_follows_from_the_section(keys, url, is_encrypted):
    section = WebSection.model_validate(keys)
    assert (section.find_browser_url("pc-b"), section.is_encrypted) == (url, is_encrypted)


@pytest.mark.parametrize(
    "url", ["farm.lab", "ftp://farm", "https://farm/x", "https://a:b@farm", "https://", "https://farm\n"]
)
def test_other_url_is_refused(url):
    with pytest.raises(ValidationError, match="use a URL like"):
        WebSection.model_validate({"url": url})


def test_name_of_the_proxy_is_a_name_of_this_host():
    assert "farm.lab" in find_host_names(WebSection(url="https://farm.lab:444"))
