"""Small disk that a test can fill, made of a private tmpfs."""

import contextlib
import subprocess
from pathlib import Path


class SmallDisk:
    """Disk mounted on a folder in separate namespaces, without root if the kernel allows that.

    Attributes
    ----------
    is_mounted
        True if the disk could be mounted.
    visible_folder
        Path of the folder for processes outside the namespaces.
    """

    def __init__(self, folder, megabytes):
        folder.mkdir()
        # `cat` ends with the process at the other end of its input, even if that process is killed.
        mount = f"mount -t tmpfs -o size={megabytes}m none '{folder}' && echo ready && exec cat"
        self._holder = subprocess.Popen(
            # `env` ends at once if this host has no `unshare`.
            ["env", "unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.is_mounted = self._holder.stdout.readline() == b"ready\n"
        self.visible_folder = Path(f"/proc/{self._holder.pid}/root{folder}")
        self._folder = folder

    def make_command(self, command, read_only=False):
        """Return a command that runs another one with the disk mounted, for reading only if `read_only`."""
        enter = ["nsenter", "--preserve-credentials", "--user", "--mount", f"--target={self._holder.pid}"]
        if read_only:
            folder = f"'{self._folder}'"
            bind = f'mount --bind {folder} {folder} && mount -o remount,bind,ro {folder} && exec "$@"'
            enter += ["unshare", "--mount", "sh", "-c", bind, "sh"]
        return [*enter, *map(str, command)]

    def fill(self):
        """Fill the disk completely."""
        with (self.visible_folder / "ballast").open("ab", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))

    def free(self):
        (self.visible_folder / "ballast").unlink(missing_ok=True)

    def end(self):
        self._holder.kill()
        self._holder.communicate()
