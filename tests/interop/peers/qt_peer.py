"""Upload a file with Qt, as Cura's plugin for OctoPrint does, in the environment of `make interop`.

``qt_peer.py URL KEY FILE NAME [FIELD=VALUE...]`` sends a multipart form with `path`, the file as NAME, and
the fields. It prints a line of JSON with the status, the headers in lower case, and the text of the body.
"""

import json
import os
import sys
from pathlib import Path

os.environ["QT_QPA_PLATFORM"] = "offscreen"

from PySide6.QtCore import QCoreApplication, QTimer, QUrl
from PySide6.QtNetwork import QHttpMultiPart, QHttpPart, QNetworkAccessManager, QNetworkRequest

TIME_LIMIT_MS = 200_000


def make_part(disposition, body, content_type):
    part = QHttpPart()
    part.setHeader(QNetworkRequest.KnownHeaders.ContentDispositionHeader, f"form-data; {disposition}")
    part.setHeader(QNetworkRequest.KnownHeaders.ContentTypeHeader, content_type)
    part.setBody(body)
    return part


def main():
    url, key, file, name, *fields = sys.argv[1:]
    app = QCoreApplication([])
    form = QHttpMultiPart(QHttpMultiPart.ContentType.FormDataType)
    form.append(make_part('name="path"', b"", "text/plain"))
    content = Path(file).read_bytes()
    form.append(make_part(f'name="file"; filename="{name}"', content, "application/octet-stream"))
    for field in fields:
        field_name, _, value = field.partition("=")
        form.append(make_part(f'name="{field_name}"', value.encode(), "text/plain"))
    request = QNetworkRequest(QUrl(url))
    request.setRawHeader(b"X-Api-Key", key.encode())
    request.setRawHeader(b"User-Agent", b"Cura/5.10.0 OctoPrintPlugin/3.7.3")
    manager = QNetworkAccessManager()
    reply = manager.post(request, form)
    reply.finished.connect(app.quit)
    QTimer.singleShot(TIME_LIMIT_MS, app.quit)
    app.exec()
    headers = {bytes(k.data()).decode().lower(): bytes(v.data()).decode() for k, v in reply.rawHeaderPairs()}
    status = reply.attribute(QNetworkRequest.Attribute.HttpStatusCodeAttribute)
    print(json.dumps({"status": status, "headers": headers, "body": bytes(reply.readAll().data()).decode()}))


main()
