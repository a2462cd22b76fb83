"""State folder that farm 0.1.0 left when its daemon, agents and printers were killed during a print.

Job 1 is done and good, job 2 was printing on um2x-01, job 3 waits for approval, job 4 is printed and on the
bed of um2-01, job 5 was cancelled before its start time. G-code files of over 100 kB were left out.
"""

import zipfile
from pathlib import Path

ARCHIVE = Path(__file__).parent / "recorded" / "state-0.1.0.zip"


def unpack_state(folder):
    """Unpack the state folder and the fleet file into a folder."""
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(folder)
    return folder / "state"
