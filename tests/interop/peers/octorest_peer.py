"""Call a server with OctoRest, a client of OctoPrint from PyPI, in the environment of `make interop`.

``octorest_peer.py URL KEY FILE`` uploads the file, selects it for printing, requests the job, the printer,
the connection and the files, and prints a line of JSON with the answers.
"""

import json
import sys

from octorest import OctoRest


def main():
    url, key, file = sys.argv[1:]
    client = OctoRest(url=url, apikey=key)
    upload_result = client.upload(file)  # OctoRest never sends its options `select` and `print`
    path = upload_result["files"]["local"]["path"]
    answers = {"version": client.version, "upload": upload_result, "held": client.files_info("local", path)}
    client.select(path, print=True)
    answers["job"] = client.job_info()
    answers["printer"] = client.printer()
    answers["state"] = client.state()
    answers["files"] = client.files()
    answers["settings"] = client.settings()
    answers["profiles"] = client.printer_profiles()
    try:
        client.select("nothing.gcode")
    except RuntimeError as error:
        answers["refusal"] = str(error)
    print(json.dumps(answers))


main()
