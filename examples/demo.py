"""`make demo`: the whole farm on eight simulated printers, from a model to its last part.

Everything except the printers' hardware is real: the daemon, an agent for each printer, pyserial on
pseudo-terminals, CuraEngine, SQLite. The printers are emulators that follow the firmware's rules and take as
long as the real moves, on a clock that runs faster (`time_scale` in fleet.yaml).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FARM = Path(sys.executable).with_name("farm")
STATE = ROOT / ".demo"


def run_farm(*arguments: str, check: bool = True) -> int:
    """Run a farm command on the demo's own state folder, as a person would type it."""
    print(f"\n$ farm {' '.join(arguments)}", flush=True)
    command = [str(FARM), *arguments, "--state", str(STATE)]
    result = subprocess.run(command, check=False, cwd=ROOT)
    if check and result.returncode != 0:
        raise SystemExit(result.returncode)
    return result.returncode


def delete_old_demo() -> None:
    """End the processes of an earlier demo, if any, and delete its files."""
    if (STATE / "farm.db").exists():
        subprocess.run(
            [str(FARM), "down", "--now", "--state", str(STATE)], check=False, capture_output=True, cwd=ROOT
        )
    shutil.rmtree(STATE, ignore_errors=True)


def main() -> int:
    """Print the example model on simulated printers, and return the exit code."""
    delete_old_demo()
    STATE.mkdir()
    model = STATE / "aqueduct.stl"
    print("It takes about four minutes. A model that is larger than any one printer:", flush=True)
    subprocess.run([sys.executable, str(ROOT / "examples" / "make_aqueduct.py"), str(model)], check=True)
    run_farm("up", "--fleet", str(ROOT / "fleet.yaml"))
    try:
        code = run_farm("submit", str(model.relative_to(ROOT)), "--wait", check=False)
        run_farm("status", check=False)
    except KeyboardInterrupt:
        code = 130
    finally:
        run_farm("down", "--now", check=False)
    print(
        f"\nParts and G-code are in {STATE.relative_to(ROOT)}/jobs/1/. On a real farm, which keeps running, "
        "a person would now\nclear each bed and confirm it. `make demo` starts from the beginning."
    )
    return code


if __name__ == "__main__":
    sys.exit(main())
