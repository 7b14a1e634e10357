"""CAN: any drive that a DBC file describes."""

import adaptdrive.hardware.link  # noqa: F401 - before python-can is imported
