"""The daemon without its broker, as a process that may be killed: `holder.py CONFIGURATION`."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from adaptdrive.config import load_configuration
from tests.integration.wire.rig import rigged


async def main(configuration: Path) -> None:
    """Run the drive until killed."""
    async with rigged(load_configuration(configuration)) as rig:
        await rig.run()
        sys.stdout.write("running\n")
        sys.stdout.flush()
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
