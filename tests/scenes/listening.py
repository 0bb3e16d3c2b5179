"""Network addresses on which processes listen."""

from __future__ import annotations

import ipaddress
from contextlib import suppress

import psutil


def addresses(process: psutil.Process) -> set[str]:
    """Addresses on which a process and all that it started listen."""
    found = set()
    with suppress(psutil.NoSuchProcess):
        for one in [process, *process.children(recursive=True)]:
            with suppress(psutil.NoSuchProcess):
                found |= {c.laddr.ip for c in one.net_connections("inet") if c.status == psutil.CONN_LISTEN}
    return found


def exposed(found: set[str]) -> set[str]:
    """Those that another machine can reach."""
    return {address for address in found if not ipaddress.ip_address(address.removeprefix("::ffff:")).is_loopback}
