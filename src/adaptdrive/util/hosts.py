"""Looking up the addresses of a host, which takes half a minute where no name server answers."""

from __future__ import annotations

import asyncio
import socket
from concurrent.futures import Future

from adaptdrive.util.threads import in_thread

Addresses = tuple[str, ...]


def look_up(host: str, port: int) -> Future[Addresses]:
    """Start to look up the addresses of a host.

    Args:
        host: Name or address.
        port: TCP port.

    Returns:
        The addresses in the order in which they are to be tried, or the error: an OSError, or a
        ValueError where the name cannot be one. The process need not wait for it to end.
    """

    def addresses() -> Addresses:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        return tuple(dict.fromkeys(str(entry[4][0]) for entry in found))

    return in_thread(addresses, "look-up")


async def find(host: str, port: int, timeout_s: float) -> Addresses:
    """Return the addresses of a host, as `look_up` does.

    Args:
        host: Name or address.
        port: TCP port.
        timeout_s: Longest wait for a name server.

    Raises:
        OSError: There is no such host, or no name server answers in time.
        ValueError: The name cannot be one.
    """
    try:
        async with asyncio.timeout(timeout_s):
            return await asyncio.wrap_future(look_up(host, port))
    except TimeoutError as problem:
        raise TimeoutError(f"no name server answers within {timeout_s:g} s") from problem
