"""Installation of CuraEngine and of Cura's settings, by the script that `make install` also runs."""

from __future__ import annotations

import subprocess
from pathlib import Path

from slicing.errors import EngineMissing
from slicing.settings import INSTALLED

_SCRIPT = Path(__file__).with_name("install-cura.sh")


def install_cura(folder: Path = INSTALLED) -> None:
    """Install CuraEngine by apt, and Cura's settings of the same version from Debian's packages.

    Does nothing if both are installed, or if the environment names them. The script says on stderr what it
    does and what is missing.

    Parameters
    ----------
    folder
        Folder for the settings; it is created complete or not at all.

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
