"""CiA 402 drives on CANopen: described by an EDS, set up over SDO, served over PDOs."""

import adaptdrive.devices.can  # noqa: F401 - before python-can is imported
