"""CiA 402 drives on CANopen: described by an EDS, set up over SDO, served over PDOs."""
