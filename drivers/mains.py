"""The mains switch of a printer: a command that a fleet may have for where heaters cannot be shown off."""

from __future__ import annotations

import logging
import shlex
import subprocess

log = logging.getLogger(__name__)

PATIENCE_S = 10.0  # wall seconds for a relay to answer


def cut(command: str, printer: str, patience_s: float = PATIENCE_S) -> str:
    """Run the command, and say in a few words what came of it. Never raises.

    Parameters
    ----------
    command
        `power_off_cmd` of `fleet.yaml`: words as in a shell, but no shell; ``{printer}`` is the name.
    printer
        Its name in the fleet.
    patience_s
        A command that takes longer is ended.
    """
    try:
        words = [word.replace("{printer}", printer) for word in shlex.split(command)]
        done = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=patience_s,
            check=False,
        )
    except (OSError, ValueError, IndexError) as error:
        said = f"power_off_cmd could not be run ({error}): switch it off by hand"
    except subprocess.TimeoutExpired:
        said = f"power_off_cmd did not end in {patience_s:g} s: switch it off by hand"
    else:
        said = "power_off_cmd took its mains away"
        if done.returncode != 0:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            said = f"power_off_cmd failed ({' '.join(last) or done.returncode}): switch it off by hand"
    log.warning("%s: %s", printer, said)
    return said
