"""Processes of a cluster, each on its own host (network namespace), connected by TLS."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from clusters.cluster_processes import make_certificates
from hosts.virtual_network import Network

WORKERS = ("w1", "w2", "w3", "w4")
SCHEDULER, FARM = "scheduler", "farm"
END_TIMEOUT_S = 30.0  # maximum time for the tasks of a round to end
SAMPLE_S = 0.2
PORT = 8786
NICE = -9  # niceness of workers; their tasks add 19 to it, and would otherwise hardly run on a busy computer


class Hosts:
    """Processes of a cluster, each on its own host."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.network = Network([SCHEDULER, *WORKERS], seed)
        self.certificates = make_certificates(folder / "certificates")
        self.address = f"tls://{self.network.get_address(SCHEDULER)}:{PORT}"
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str) -> None:
        """Start the scheduler, or a worker."""
        programs, certificates = Path(sys.executable).parent, self.certificates
        if name == SCHEDULER:
            command = [str(programs / "dask"), "scheduler", "--protocol", "tls", "--port", str(PORT)]
            command += ["--host", self.network.get_address(SCHEDULER), "--no-dashboard", "--no-show"]
            command += [
                "--tls-ca-file",
                str(certificates / "ca.pem"),
                "--tls-cert",
                str(certificates / "cert.pem"),
            ]
            command += ["--tls-key", str(certificates / "key.pem")]
        else:
            command = [str(programs / "farm"), "worker", self.address, "--certificates", str(certificates)]
            command += ["--name", name, "--folder", str(self.folder / name), "--slots", "1"]
        path = os.pathsep.join(filter(None, sys.path))
        with (self.folder / f"{name}.log").open("a") as log:
            self._running[name] = subprocess.Popen(
                self.network.make_command(name, ["nice", "-n", str(NICE), *command]),
                stdout=log,
                stderr=log,
                env=os.environ | {"PYTHONPATH": path},
            )

    def send_signal(self, name: str, signal_number: signal.Signals) -> None:
        """Send a signal to a process."""
        self._running[name].send_signal(signal_number)
        if signal_number is signal.SIGKILL:
            self._running[name].wait()

    def count_tasks(self) -> int:
        """Count the tasks of the workers, by their folders, and the running engines."""
        folders = sum(1 for name in WORKERS for _ in (self.folder / name / "tasks").glob("*"))
        return folders + sum(_is_engine(pid) for name in WORKERS for pid in self.network.list_pids(name))

    def count_processes(self) -> dict[str, int]:
        """Count the processes of each host."""
        return {name: len(self.network.list_pids(name)) for name in (SCHEDULER, *WORKERS)}

    def end(self) -> int:
        """End all processes as systemd ends services; return the number of processes that still run."""
        for process in self._running.values():
            process.terminate()
        deadline_s = time.monotonic() + END_TIMEOUT_S
        while (count := sum(self.count_processes().values())) and time.monotonic() < deadline_s:
            for process in self._running.values():
                process.poll()
            time.sleep(SAMPLE_S)
        return count

    def close(self) -> None:
        """End the network and all remaining processes."""
        self.network.close()
        for process in self._running.values():
            process.wait()


def _is_engine(pid: int) -> bool:
    try:
        return "CuraEngine" in Path(f"/proc/{pid}/comm").read_text()
    except OSError:
        return False


def list_children(pid: int) -> list[int]:
    """List the child processes of a process; empty if the process has ended."""
    children: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            children += map(int, path.read_text().split())
    return children
