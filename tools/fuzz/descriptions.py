"""Decoders of what a user or a maker wrote: configurations, commands, DBCs, EDS files."""

from __future__ import annotations

import json
from contextlib import suppress

from cantools.database.errors import EncodeError

from adaptdrive.config.file import parse_configuration
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.database import SignalCatalogue, read_dbc
from adaptdrive.devices.can.kind import candidates, proofs
from adaptdrive.devices.canopen.dictionary import ObjectCatalogue, read_eds
from adaptdrive.devices.canopen.mapping import codec, pack, pdos_of
from adaptdrive.mqtt.commands import Payload
from adaptdrive.runtime.requests import REQUESTS
from adaptdrive.util.errors import ConfigurationError, RefusedError
from tools.fuzz.target import EXAMPLES, Target, damaged_file

NODE = 5


def toml(data: bytes) -> object:
    """Read a configuration."""
    return parse_configuration(data.decode("utf-8", "replace"), EXAMPLES / "fuzzed.toml")


def mqtt(data: bytes) -> object:
    """Read a command; the first byte chooses its verb."""
    payload = Payload(data[1:])
    json.dumps([payload.id, payload.value, payload.user])
    return payload.request(tuple(REQUESTS)[data[0] % len(REQUESTS)] if data else "")


def dbc(data: bytes) -> object:
    """Read a DBC, and look at each of its signals."""
    database, remarks = read_dbc(damaged_file("fuzzed.dbc", data))
    catalogue = SignalCatalogue(database, remarks, fd=True)
    for message in database.messages:
        proofs(message)
        if catalogue.message(message.name, "bus") is not None:
            with suppress(EncodeError, ValueError):  # pages, or a range
                MessageCodec(message).encode({})
        for signal in message.signals:
            catalogue.find(f"{message.name}.{signal.name}", "signals.output")
    return list(candidates(database))


def eds(data: bytes) -> object:
    """Read an EDS, and pack each of its entries into a frame."""
    catalogue = ObjectCatalogue(*read_eds(damaged_file("fuzzed.eds", data), NODE))
    entries = (catalogue.at((one.index, one.subindex)) for one in catalogue.variables())
    found = [entry for entry in entries if entry is not None]
    packed = pack(pdos_of("TPDO", NODE)[:1], found[:2])
    return catalogue.identity, [codec(pdo) for pdo in packed or []]


def _texts(*names: str) -> tuple[bytes, ...]:
    return tuple((EXAMPLES / name).read_bytes() for name in names)


_COMMANDS = (
    b'0{"id":"a","value":3.3}',
    b'1{"id":"b","value":{"shape":"square","low":3,"high":3.2,"period_s":20}}',
    b'4{"id":"c","value":300,"hold_s":2,"user":"x","expires":"2026-01-01T00:00:00Z"}',
    b'5{"id":"d"}',
)
_EDS = b"""[FileInfo]
FileName=a.eds
[DeviceInfo]
VendorNumber=0x123
ProductNumber=7
[MandatoryObjects]
SupportedObjects=2
1=0x1000
2=0x1018
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x20192
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2
[1018sub0]
ParameterName=Count
ObjectType=0x7
DataType=0x0005
AccessType=ro
[1018sub1]
ParameterName=Vendor
ObjectType=0x7
DataType=0x0007
AccessType=ro
LowLimit=$NODEID+1
[OptionalObjects]
SupportedObjects=2
1=0x6041
2=0x2001
[6041]
ParameterName=Statusword
ObjectType=0x7
DataType=0x0006
AccessType=ro
PDOMapping=1
[2001]
ParameterName=Speed
ObjectType=0x7
DataType=0x0008
AccessType=rw
LowLimit=-10
HighLimit=1e3
PDOMapping=1
"""
_DBC = b"""VERSION ""
BU_: A
BO_ 100 Status: 8 A
 SG_ Volts : 0|16@1+ (0.01,0) [0|600] "V" A
 SG_ Speed : 23|16@0- (0.1,-5) [-3000|3000] "rpm" A
 SG_ Mode M : 32|4@1+ (1,0) [0|0] "" A
 SG_ Deep m1 : 40|8@1+ (1,0) [0|0] "" A
CM_ SG_ 100 Volts "boost";
BA_DEF_ SG_ "GenSigStartValue" INT 0 100;
BA_DEF_DEF_ "GenSigStartValue" 1;
BA_ "GenSigStartValue" SG_ 100 Volts 7;
VAL_ 100 Mode 0 "off" 1 "on";
SIG_VALTYPE_ 100 Speed : 0;
"""
_FLOAT_DBC = b"""VERSION ""
BU_: A
BO_ 101 Order: 8 A
 SG_ Volts : 0|16@1+ (0.01,0) [0|600] "V" A
 SG_ Speed : 23|16@0- (0.1,-5) [-3000|3000] "rpm" A
BA_DEF_ SG_ "GenSigStartValue" FLOAT -1e9 1e9;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 101 Volts 7;
BA_ "GenSigStartValue" SG_ 101 Speed -1.5;
"""

DESCRIPTIONS: dict[str, Target] = {
    "toml": Target(
        toml, (ConfigurationError,), _texts("motor.toml", "bath-modbus-tcp.toml"), 60, 0.1
    ),
    "mqtt": Target(mqtt, (RefusedError,), _COMMANDS, 4000),
    "dbc": Target(dbc, (ConfigurationError,), (*_texts("inverter.dbc"), _DBC, _FLOAT_DBC), 60, 0.1),
    "eds": Target(eds, (ConfigurationError,), (_EDS, *_texts("cia402.eds"), _EDS), 60, 0.1),
}
