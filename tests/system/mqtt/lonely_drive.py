"""A service in a process of its own, to be killed: `lonely_drive.py PORT FOLDER`."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from tests.support import Broker
from tests.unit.mqtt.peers import serving


async def main(port: int, folder: Path) -> None:
    async with serving(Broker("127.0.0.1", port), "lonely", folder):
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Path(sys.argv[2])))
