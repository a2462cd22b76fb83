"""Scheduler and workers of a cluster, each in its own process."""

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path

import dask


def make_certificates(folder):
    """Make a key and a self-signed certificate."""
    folder.mkdir()
    request = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=farm-cluster"]
    files = ["-keyout", folder / "key.pem", "-out", folder / "cert.pem", "-days", "2"]
    subprocess.run([*request, *files], check=True, capture_output=True)
    (folder / "ca.pem").write_bytes((folder / "cert.pem").read_bytes())
    return folder


async def run_scheduler(folder, certificates):
    """Run a scheduler whose address is kept over restarts, in a file in the folder."""
    from distributed import Scheduler

    from farm.compute.cluster.security import make_security

    security = make_security("tls://", certificates)
    file = folder / "address"
    port = int(file.read_text().rpartition(":")[2]) if file.exists() else 0
    async with Scheduler(
        host="127.0.0.1", port=port, protocol="tls", security=security, dashboard_address="127.0.0.1:0"
    ) as scheduler:
        (folder / "address.new").write_text(scheduler.address)
        (folder / "address.new").replace(folder / "address")
        await scheduler.finished()


def run_worker(folder, certificates, address, name):
    """Run a worker with one slot that reports the versions of the tests' installation."""
    from clusters.dask_cluster import INSTALLATION
    from farm.compute.cluster import worker_service

    worker_service.read_installation = lambda: INSTALLATION
    options = worker_service.WorkerOptions(address, certificates, name, folder / name, slot_count=1)
    options.folder.mkdir(exist_ok=True)
    asyncio.run(worker_service.serve_tasks(options, None))


class ClusterProcesses:
    """The processes of a cluster, which a test kills."""

    def __init__(self, folder):
        self.folder = folder
        self.certificates = make_certificates(folder / "certificates")
        self.processes = {}

    async def start_scheduler(self):
        """Start the scheduler; return its address."""
        self._start("scheduler")
        while not (self.folder / "address").exists():
            assert self.processes["scheduler"].poll() is None, (self.folder / "scheduler.log").read_text()
            await asyncio.sleep(0.05)
        self.address = (self.folder / "address").read_text()
        return self.address

    def start_worker(self, name):
        self._start("worker", self.address, name)

    def send_signal(self, name, number):
        self.processes[name].send_signal(number)

    def close(self):
        for process in self.processes.values():
            process.send_signal(signal.SIGKILL)
            process.wait()

    def _start(self, role, *args):
        name = args[-1] if args else role
        command = [sys.executable, __file__, role, self.folder, self.certificates, *args]
        path = os.pathsep.join(filter(None, sys.path))
        with (self.folder / f"{name}.log").open("w") as log:
            self.processes[name] = subprocess.Popen(
                command, stdout=log, stderr=log, env=os.environ | {"PYTHONPATH": path}
            )


if __name__ == "__main__":
    dask.config.set({"distributed.scheduler.work-stealing": False})
    role, folder, certificates, *rest = sys.argv[1:]
    if role == "scheduler":
        asyncio.run(run_scheduler(Path(folder), Path(certificates)))
    else:
        run_worker(Path(folder), Path(certificates), *rest)
