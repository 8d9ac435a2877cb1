"""The socket that a host of this user has for Stop alone, beside its port.

Invariant: only a socket that this user alone can have put there is taken; without one, a Stop goes by the port as every call.
"""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path


def stop_doors(address: str) -> Iterator[str]:
    """Paths of sockets for Stop beside the port ``address``, which a killed host may have left."""
    try:
        host, _, port = address.rpartition(":")
        directory = _state_home() / "run"
        if not _is_own(directory):
            return
        # Networks have ports of their own, so the name names the network, too.
        network = os.stat("/proc/self/ns/net").st_ino
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)
        ips = [ipaddress.ip_address(at[0]) for *_, at in found]
    except (OSError, ValueError):
        return
    for ip in ips:
        path = directory / f"at-{f'[{ip}]' if ip.version == 6 else ip}:{port}.{network:x}.stop"
        if ip.is_loopback and path.exists():
            yield str(path)


def _state_home() -> Path:
    """As the host finds it."""
    told = os.environ.get("XDG_STATE_HOME", "")
    if told.startswith("/"):
        return Path(told, "trocar")
    home = os.environ.get("HOME", "")
    return Path(home, ".local/state/trocar") if home else Path(os.environ.get("TMPDIR") or "/tmp", "trocar")


def _is_own(directory: Path) -> bool:
    """Nobody else can have written there."""
    told = directory.lstat()
    return stat.S_ISDIR(told.st_mode) and told.st_uid == os.geteuid() and not told.st_mode & 0o022
