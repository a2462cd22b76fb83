"""Installation of CuraEngine and of Cura's settings, by the script that `make install` also runs."""

from __future__ import annotations

import subprocess
from pathlib import Path

from slicing.errors import EngineMissing
from slicing.settings import INSTALLATION_FOLDER

_SCRIPT = Path(__file__).with_name("install-cura.sh")


def install_cura(folder: Path = INSTALLATION_FOLDER) -> None:
    """Install CuraEngine with apt, and Cura's settings of the same version from Debian's packages.

    Nothing happens if both are installed, or if the environment names them. The script reports its steps, and
    anything that is missing, on stderr.

    Parameters
    ----------
    folder
        Folder for the settings; it is created completely or not at all.

    Raises
    ------
    EngineMissing
        If they cannot be installed.
    """
    try:
        process = subprocess.run(["bash", str(_SCRIPT), str(folder.absolute())], check=False)
    except OSError as error:
        raise EngineMissing(f"{_SCRIPT} cannot be run: {error}") from error
    if process.returncode != 0:
        raise EngineMissing(f"CuraEngine and its settings in {folder} could not be installed: see above")
