"""A folder as a network file system shows it: renames and flushes are slow, and attributes may be seconds old.

Run: ``/usr/bin/python3 benchmarks/slowfs.py BACKING MOUNT``, as root, with Debian's python3-pyfuse3 and fuse3. Two
mounts of one backing folder act as two machines: neither sees the other's changes at once.
"""

from __future__ import annotations

import errno
import os
import random  # noqa: TID251 (of the delays; nothing here reaches the data)
import sys
from pathlib import Path

import pyfuse3
import trio

RENAME, FLUSH = 0.15, 0.05
"""Mean seconds that a rename and a flush take."""
STALE = 3.0
"""Seconds for which names, attributes and the absence of a file are cached, as by NFS (acregmin)."""


class Slow(pyfuse3.Operations):
    """Passes all operations on to a backing folder."""

    enable_writeback_cache = False

    def __init__(self, backing: str) -> None:
        super().__init__()
        self._paths = {pyfuse3.ROOT_INODE: backing}
        self._delays = random.Random(os.getpid())

    async def _wait(self, mean: float) -> None:
        await trio.sleep(self._delays.expovariate(1.0 / mean))

    def _path(self, parent: int, name: bytes) -> str:
        return os.path.join(self._paths[parent], os.fsdecode(name))

    def _attributes(self, path: str) -> pyfuse3.EntryAttributes:
        try:
            status = os.lstat(path)
        except OSError as error:
            raise pyfuse3.FUSEError(error.errno) from None
        entry = pyfuse3.EntryAttributes()
        for name in ("st_mode", "st_nlink", "st_uid", "st_gid", "st_rdev", "st_size"):
            setattr(entry, name, getattr(status, name))
        for name in ("st_atime_ns", "st_mtime_ns", "st_ctime_ns"):
            setattr(entry, name, getattr(status, name))
        entry.st_ino = status.st_ino
        entry.st_blksize, entry.st_blocks = 4096, (status.st_size + 511) // 512
        entry.entry_timeout = entry.attr_timeout = STALE
        return entry

    def _known(self, path: str) -> pyfuse3.EntryAttributes:
        entry = self._attributes(path)
        self._paths[entry.st_ino] = path
        return entry

    async def lookup(self, parent, name, ctx=None):
        """Find a name; its absence is cached for a while too."""
        path = self._path(parent, name)
        if not os.path.lexists(path):
            entry = pyfuse3.EntryAttributes()
            entry.st_ino, entry.entry_timeout = 0, STALE
            return entry
        return self._known(path)

    async def getattr(self, inode, ctx=None):
        """Return attributes."""
        return self._attributes(self._paths[inode])

    async def setattr(self, inode, attr, fields, fh, ctx):
        """Change the attributes that are ever changed here: size and mode."""
        path = self._paths[inode]
        if fields.update_size:
            os.truncate(path, attr.st_size)
        if fields.update_mode:
            os.chmod(path, attr.st_mode & 0o7777)
        return self._attributes(path)

    async def opendir(self, inode, ctx):
        """Open a folder."""
        return inode

    async def readdir(self, fh, start, token):
        """List a folder."""
        folder = self._paths[fh]
        for number, name in enumerate(sorted(os.listdir(folder))):
            if number < start:
                continue
            try:
                entry = self._known(os.path.join(folder, name))
            except pyfuse3.FUSEError:
                continue
            if not pyfuse3.readdir_reply(token, os.fsencode(name), entry, number + 1):
                break

    async def mkdir(self, parent, name, mode, ctx):
        """Make a folder."""
        path = self._path(parent, name)
        self._try(os.mkdir, path, mode)
        return self._known(path)

    async def unlink(self, parent, name, ctx):
        """Remove a file."""
        self._try(os.unlink, self._path(parent, name))

    async def rmdir(self, parent, name, ctx):
        """Remove a folder."""
        self._try(os.rmdir, self._path(parent, name))

    async def rename(self, parent, name, new_parent, new_name, flags, ctx):
        """Rename, slowly."""
        await self._wait(RENAME)
        old, new = self._path(parent, name), self._path(new_parent, new_name)
        self._try(os.replace, old, new)
        self._paths[os.lstat(new).st_ino] = new

    async def create(self, parent, name, mode, flags, ctx):
        """Make a file."""
        path = self._path(parent, name)
        handle = self._try(os.open, path, flags | os.O_CREAT, mode)
        return pyfuse3.FileInfo(fh=handle), self._known(path)

    async def open(self, inode, flags, ctx):
        """Open a file."""
        return pyfuse3.FileInfo(fh=self._try(os.open, self._paths[inode], flags))

    async def read(self, fh, start, size):
        """Read."""
        return os.pread(fh, size, start)

    async def write(self, fh, start, data):
        """Write."""
        return self._try(os.pwrite, fh, data, start)

    async def flush(self, fh):
        """Do nothing, since no writes are held back."""

    async def fsync(self, fh, datasync):
        """Flush, slowly."""
        await self._wait(FLUSH)
        self._try(os.fsync, fh)

    async def fsyncdir(self, fh, datasync):
        """Flush a folder, slowly."""
        await self._wait(FLUSH)

    async def release(self, fh):
        """Close."""
        os.close(fh)

    async def statfs(self, ctx):
        """Return the backing folder's space."""
        reply, status = pyfuse3.StatvfsData(), os.statvfs(self._paths[pyfuse3.ROOT_INODE])
        for name in ("f_bsize", "f_frsize", "f_blocks", "f_bfree", "f_bavail", "f_files", "f_ffree", "f_favail"):
            setattr(reply, name, getattr(status, name))
        return reply

    def _try(self, work, *arguments):
        try:
            return work(*arguments)
        except OSError as error:
            raise pyfuse3.FUSEError(error.errno or errno.EIO) from None


def main() -> None:
    """Mount, and serve until it is unmounted."""
    backing, mount = (str(Path(argument).resolve()) for argument in sys.argv[1:3])
    pyfuse3.init(Slow(backing), mount, {*pyfuse3.default_options, "fsname=slowfs", "allow_other"})
    try:
        trio.run(pyfuse3.main)
    finally:
        pyfuse3.close(unmount=True)


if __name__ == "__main__":
    main()
