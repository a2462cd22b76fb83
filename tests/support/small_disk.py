"""Disk of some megabytes that a test fills: a private tmpfs."""

import contextlib
import subprocess
from pathlib import Path


class SmallDisk:
    """Disk mounted on a folder in separate namespaces, which needs no rights if the kernel allows those.

    Attributes
    ----------
    there
        Whether it could be mounted.
    seen
        The folder, as processes outside see it.
    """

    def __init__(self, folder, megabytes):
        folder.mkdir()
        # `cat` ends with whoever has the other end of its input, even where that is killed.
        mount = f"mount -t tmpfs -o size={megabytes}m none '{folder}' && echo ready && exec cat"
        self._holder = subprocess.Popen(
            # By `env`, which ends at once where this host has no `unshare`.
            ["env", "unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.there = self._holder.stdout.readline() == b"ready\n"
        self.seen = Path(f"/proc/{self._holder.pid}/root{folder}")
        self._folder = folder

    def command(self, command, read_only=False):
        """Return a command that runs with the disk mounted; `read_only`: without write access."""
        entered = ["nsenter", "--preserve-credentials", "--user", "--mount", f"--target={self._holder.pid}"]
        if read_only:
            at = f"'{self._folder}'"
            bind = f'mount --bind {at} {at} && mount -o remount,bind,ro {at} && exec "$@"'
            entered += ["unshare", "--mount", "sh", "-c", bind, "sh"]
        return [*entered, *map(str, command)]

    def fill(self):
        """Fill the disk completely."""
        with (self.seen / "ballast").open("ab", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))

    def free(self):
        (self.seen / "ballast").unlink(missing_ok=True)

    def end(self):
        self._holder.kill()
        self._holder.communicate()
