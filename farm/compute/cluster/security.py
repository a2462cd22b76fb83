"""Certificates with which the computers of a cluster authenticate each other."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from farm.errors import ErrorCode, FarmError

if TYPE_CHECKING:
    from distributed import Security

AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE = "ca.pem", "cert.pem", "key.pem"


def check_cluster(scheduler: str, certificates: Path | None) -> None:
    """Check that a cluster can be used from this computer, before connecting to it.

    Raises
    ------
    FarmError
        With code `settings` if Dask is not installed, or a certificate is missing.
    """
    if importlib.util.find_spec("distributed") is None:
        raise FarmError(
            "a cluster needs Dask, which is not installed: pip install 'farm[cluster]'", ErrorCode.SETTINGS
        )
    if urlsplit(scheduler).scheme != "tls":
        return
    if certificates is None:
        raise FarmError(f"{scheduler}: needs a folder with certificates", ErrorCode.SETTINGS)
    for name in (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE):
        if not (certificates / name).is_file():
            raise FarmError(
                f"{certificates}: lacks {name}; the how-to 'Compute on a cluster' explains how to make it",
                ErrorCode.SETTINGS,
            )


def make_security(scheduler: str, certificates: Path | None) -> Security | None:
    """Build Dask's TLS settings from the files of a folder.

    Returns
    -------
    Security | None
        None for a scheduler on this computer without TLS.

    Raises
    ------
    FarmError
        See `check_cluster`.
    """
    check_cluster(scheduler, certificates)
    if certificates is None:
        return None
    from distributed import Security

    cert, key = str(certificates / CERTIFICATE_FILE), str(certificates / KEY_FILE)
    return Security(
        require_encryption=True,
        tls_ca_file=str(certificates / AUTHORITY_FILE),
        tls_client_cert=cert,
        tls_client_key=key,
        tls_worker_cert=cert,
        tls_worker_key=key,
        tls_scheduler_cert=cert,
        tls_scheduler_key=key,
    )
