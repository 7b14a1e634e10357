"""The causes of trips with their remedies: the table of `docs/operation.md`, and of each message.

An interlock gives its cause as text. The first entry whose sign occurs in that text applies, so a
special cause stands before the general one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trip:
    """A kind of trip.

    Attributes:
        sign: Regular expression that occurs in the text of such a trip.
        example: Text of such a trip; `…` stands for the rest.
        cause: Cause in words.
        remedy: Steps that remove the cause, before `reset`.
    """

    sign: str
    example: str
    cause: str
    remedy: str


_STALE = "stale: measurement is 54 ms old, limit 50 ms"
_OLDEST = f"{_STALE}; output (0x101 (DriveLoad), Tachometer) is the oldest value, 54 ms old"

TRIPS = (
    Trip(
        r"^stale: .*: no message comes",
        f"{_OLDEST}: no message comes: …",
        "no message of the drive arrives",
        "check the drive's supply, the cable, the bit rate, the ids",
    ),
    Trip(
        r"^stale: .*: other messages come",
        f"{_OLDEST}: other messages come: …",
        "only this message is missing, or too rare",
        "switch the message on in the drive; compare its id with the DBC; where `adaptdrive probe` "
        "shows it, a longer `interlocks.stale_s`",
    ),
    Trip(
        r"^stale: .*: its frames come and are refused",
        f"{_OLDEST}: its frames come and are refused (wrong_checksum, 12 in a row): …",
        "the frames fail a check; also `wrong_length`, `counter_stuck`, `out_of_range`",
        "compare the setting that the text names; `adaptdrive probe` shows the frames",
    ),
    Trip(
        r"^stale: .*; the polls give no reading: (no reply within \S+ s($|; bytes| to )"
        r"|no reply has come .*$|the connection was closed|the device closed the connection)",
        f"{_STALE}; the polls give no reading: no reply within 0.05 s",
        "the device does not answer, or answers later than `bus.timeout_s`",
        "check the device's supply, the cable, the address of the device, and where other bytes "
        "come the bit rate and the parity; on a busy machine "
        "set longer `bus.timeout_s` and `interlocks.stale_s`, or `realtime.priority`",
    ),
    Trip(
        r"^stale: .*; the polls give no reading",
        f"{_STALE}; the polls give no reading: exception reply 2 to function 4 (illegal address), "
        "input 16…19 (address from 0)",
        "the device refuses the poll",
        "check the register map, or `[bus.values]`; `adaptdrive probe` shows the registers",
    ),
    Trip(
        r"^stale: no measurement yet",
        "stale: no measurement yet",
        "a command was refused before the first frame",
        "start the drive; compare `[bus]` and `[signals]` with `adaptdrive probe`",
    ),
    Trip(
        r"^stale: .*: no measurement yet",
        "stale: module.water: no measurement yet",
        "that value of a sensor bus has never arrived",
        "check the module, its cable and its bus; compare `[[sensor_bus]]` with the module; "
        "`adaptdrive probe` shows each value with its age",
    ),
    Trip(
        r"^stale: measurement is ",
        f"{_STALE}; …",
        "no usable measurement for `interlocks.stale_s`; if the text names no value and events "
        "`latency` come, the machine is overloaded",
        "check the part that the text names; without one, reduce the load of the machine, lengthen "
        "`interlocks.stale_s`, or set `realtime.priority`",
    ),
    Trip(
        r"^stale: ",
        "stale: module.water is 5012 ms old, limit 5000 ms",
        "a value of a sensor bus is older than its own limit",
        "check the module, its cable and its bus; `adaptdrive probe` shows each value with its age",
    ),
    Trip(
        r"^invalid: ",
        "invalid: output = nan is not a finite number: look at its sensor, its scale and offset, "
        "and at [derived]",
        "the named measured value is NaN or infinite",
        "check its sensor, its `scale` and `offset`, and `[derived]`",
    ),
    Trip(
        r"^overslept: ",
        "overslept: the daemon did not run for 512 ms, limit 50 ms: …",
        "the process was frozen, suspended or starved; the drive may have stopped meanwhile",
        "reduce the load of the machine, give the daemon priority by `realtime.priority`, or set "
        "the limit that the text names",
    ),
    Trip(
        r"^drive fault: ",
        "drive fault: word 0x3",
        "the drive reports a fault; its name stands before the word if the description has one",
        "look the fault up in the drive's manual and clear it in the drive",
    ),
    Trip(
        r"^node \d+: emergency ",
        "node 5: emergency 0x2310, continuous over-current at the output (error register 0x01)",
        "a CiA 402 drive reports an error",
        "remove the error that the text names; the drive reports *no error*, or leaves its fault, "
        "before `reset` is accepted",
    ),
    Trip(
        r"^node \d+: the drive left its state by itself, or may have: ",
        "node 5: the drive left its state by itself, or may have: nothing was heard of it for 60 "
        "ms while it was commanded on",
        "a CiA 402 drive is not on after a silence",
        "look for lost frames on the bus and an overloaded machine; `bus.heartbeat_timeout_s` must "
        "be longer than the silences of both",
    ),
    Trip(
        r"^node \d+: the drive left its state by itself: ",
        "node 5: the drive left its state by itself: fault",
        "the drive entered a fault without an emergency, or another state without a command",
        "look the fault up in the drive's manual; `reset` also resets the drive's fault",
    ),
    Trip(
        r"^node \d+: the drive's state is ",
        "node 5: the drive's state is fault",
        "the drive is in a fault, or has not reported its state",
        "look the fault up in the drive's manual; `not known yet` ends when its TPDOs arrive",
    ),
    Trip(
        r"^node \d+: has been restarted",
        "node 5: has been restarted",
        "the drive has restarted by itself; the daemon sets it up again",
        "check the drive's supply",
    ),
    Trip(
        r"^node \d+: heartbeat lost",
        "node 5: heartbeat lost for 112 ms",
        "the drive sends no heartbeat",
        "check the drive's supply and the cable; the daemon sets the drive up again",
    ),
    Trip(
        r"^node \d+: is set up again: another sender has written its objects",
        "node 5: is set up again: another sender has written its objects",
        "another sender has written objects of the drive over SDO",
        "end the other sender; the daemon sets the drive up again by itself",
    ),
    Trip(
        r"^node \d+: is not operational any more",
        "node 5: is not operational any more (state 127)",
        "another NMT master has stopped the drive",
        "end the other NMT master",
    ),
    Trip(
        r"^over-voltage: ",
        "over-voltage: v_bst = 431.2 V, limit 430 V",
        "boost voltage above `boost_voltage_max_V`",
        "look for a load that feeds back into a unidirectional drive, and for a wrong capacitance "
        "in `[drive]`",
    ),
    Trip(
        r"^precharge: ",
        "precharge: v_bst = 171.0 V after 5 s, needs 200 V; a boost stage that works only with the "
        "enable bit on needs drive.enable_bit = 'bridge-and-boost'; else the drive refuses the "
        "commands (checksum, counter, local instead of remote mode), or line or precharge circuit "
        "is open",
        "`starting` took too long",
        "check `drive.enable_bit`, then whether the drive refuses commands (checksum, counter, "
        "local mode), the line voltage and the precharge circuit",
    ),
    Trip(
        r"^output above its limit: ",
        "output above its limit: speed = 5.1 V, limit 5 V: look for a lost load, or at the sensor",
        "output above `output_max`",
        "check the sensor and the coupling to the load",
    ),
    Trip(
        r"^output below its limit: ",
        "output below its limit: speed = -1.2 V, limit -1.125 V: is the sensor reversed, or its "
        "wire broken?",
        "output below `output_min`",
        "check the sign and the wires of the sensor",
    ),
    Trip(
        r"^frame rate: not known ",
        "frame rate: not known 5 s after the start: the drive's half-cycle counter jumps again "
        "and again, or its readings are too few: look for a gateway that repeats or loses frames, "
        "and at signals.counter",
        "no rate within `interlocks.precharge_timeout_s` or `hold_s`; nothing was energised",
        "look for a gateway that repeats or loses frames, or sends four or more at once; leave "
        "`signals.counter` out where it does not count each half cycle",
    ),
    Trip(
        r"^frame rate: ",
        "frame rate: the drive sends 100 readings/s, expected 120/s: look at "
        "drive.line_frequency_Hz, bus.clock and bus.clock_ticks",
        "the message `bus.clock` does not come at the rate of the half cycles",
        "correct `drive.line_frequency_Hz`, or set `bus.clock` to a message of every half cycle, "
        "or `bus.clock_ticks` to the half cycles between two messages",
    ),
    Trip(
        r"^half-cycle counter: ",
        "half-cycle counter: the drive's count has stood for 58 ms while frames come, limit 50 ms: "
        "its control hangs, or its last frame is repeated",
        "frames come and `signals.counter` stands: the measurements may be old",
        "restart the drive; look for a gateway that repeats frames; leave `signals.counter` out "
        "where it does not count each half cycle, also with the bridge off",
    ),
    Trip(
        r"^refused frames: ",
        "refused frames: drive: 52% of the last 1190 frames were refused, most for wrong_checksum "
        "(619): …, limit 50%",
        "the share of refused frames over 5 s has reached `interlocks.refused_share`",
        "check what the text names; `adaptdrive probe` shows the frames",
    ),
    Trip(
        r"^stuck: ",
        "stuck: speed stands at exactly … V for … s, and speed should have moved by … V",
        "the output, or a value of it, does not change although the input moves the load",
        "check the sensor: its value is frozen while its messages continue",
    ),
    Trip(
        r"^the drive does not stop: its bridge is still on ",
        "the drive does not stop: its bridge is still on 512 ms after the stop; …",
        "the drive does not follow commands: local mode, checksum, another sender, a welded "
        "contact",
        "disconnect its supply; look at `wrong_checksum` in the drive's own diagnosis and at its "
        "mode",
    ),
    Trip(
        r"^the drive does not stop: it has not taken the safe command",
        "the drive does not stop: it has not taken the safe command …",
        "the bus did not send the safe command, or the drive refused it",
        "disconnect the drive's supply; the trip or the `bus` events give the reason",
    ),
    Trip(
        r"^the drive does not stop: ",
        "the drive does not stop: it has not reported its bridge off …",
        "the drive stopped sending measurements during its stop",
        "assume that the drive is energised; check the cable and the supply",
    ),
    Trip(
        r"^the drive's bridge is on although ",
        "the drive's bridge is on although this daemon did not command it: …",
        "a second sender, the drive's panel or a restart of the drive switched the bridge on",
        "remove that source",
    ),
    Trip(
        r"^the drive refuses commands: ",
        "the drive refuses commands: exception code 3 (illegal value) at register 0; …",
        "Modbus: two commands in a row were refused, or five not taken; the drive may still "
        "follow an older one",
        "check the register map, its limits, remote mode and write access",
    ),
    Trip(
        r"^the drive does not answer commands: ",
        "the drive does not answer commands: …",
        "Modbus: the drive answered reads, but took none of five commands in a row",
        "check write access; look at `timeouts`, `exceptions` and `foreign` in `bus`",
    ),
    Trip(
        r"^the bus does not take commands: ",
        "the bus does not take commands: 3 in a row were refused while the drive's messages came; "
        "look for another sender that keeps the bus busy, and for an adapter that sends nothing",
        "the interface's queue is full, or it cannot send; the drive stops by its own time-out",
        "look for a sender of higher priority (`candump`) and at "
        "`ip -details -statistics link show can0`, and reset the adapter; `txqueuelen` must be "
        "larger than the frames of one command",
    ),
    Trip(
        r"^drive restarted: ",
        "drive restarted: its half-cycle counter began anew, 3 where 41207 was due",
        "`signals.counter` has begun anew near 0 while the bridge was commanded on",
        "check the drive's supply and its control for the cause of the restart",
    ),
    Trip(
        r"^drive stopped: ",
        "drive stopped: its bridge is off although it was commanded on",
        "the drive has reported its bridge off, or has not reported it on within "
        "`interlocks.start_s`; the text names what hid the stop, such as a silence or a lost bus",
        "check the drive's own time-out and protection, remote mode and checksum, and look for "
        "lost commands, a loose cable and an overloaded machine; a drive that needs longer to come "
        "on needs a longer `interlocks.start_s`",
    ),
    Trip(
        r"^another sender commands this drive: ",
        "another sender commands this drive: 12 x frame 0x080 (DriveCommand), the last 0.0 s ago; "
        "end the other daemon, PLC or tool: the bus must be free of its commands for 5 s",
        "this daemon has not sent these frames with the id of the drive's command",
        "end the other daemon, PLC or test tool; `reset` and `enable` are refused until the bus "
        "has been free of its commands for 5 s",
    ),
    Trip(
        r"^no response: .* must be above ",
        "no response: speed = … V, and with this input must be above … V: is the sensor reversed "
        "or its wire broken, is the load blocked?",
        "the output is lower than any load within `interlocks.response_factor` of "
        "`[load.model]` gives",
        "check the sign and the wires of the sensor, the shaft or the heater, and `[load.model]`",
    ),
    Trip(
        r"^no response: .* fell to ",
        "no response: speed fell to … V, and the load cannot have fallen below … V yet: is the "
        "sensor's wire broken?",
        "the output fell ten times faster than the model allows",
        "check the sensor's wires and supply",
    ),
    Trip(
        r"^no response: ",
        "no response: input at its limit for long, and the output has not moved",
        "the input was at a limit for `response_s`, which moves every load within the "
        "supervisor's bounds",
        "check for an unplugged sensor, a blocked shaft, a broken heater",
    ),
    Trip(
        r"^no current: ",
        "no current: the current has left in one step: is the battery disconnected?",
        "the current fell from over four times `load.charge.end_current_A` to below it in one step",
        "check the battery's cable, its fuse and its own protection",
    ),
    Trip(
        r"^charge time: ",
        "charge time: the charge has not ended within load.charge.longest_h = … h: does the "
        "current sensor read too high?",
        "the drive was on for longer than `load.charge.longest_h`",
        "look whether the current is 0 with the drive off; a larger battery or a smaller set-point "
        "needs more time",
    ),
    Trip(
        r"^limit cycle: ",
        "limit cycle: the fixed controller drives V_c from limit to limit",
        "at a constant set-point V_c went sixty times from one limit to the other",
        "`adaptdrive commission`: the load is not the one of `[load.model]`",
    ),
    Trip(
        r"^manual: ",
        "manual: no new voltage within the 5 s that its sender had set",
        "the program that sets V_c has sent none within its own `hold_s`",
        "look at that program and its connection; a voltage without `hold_s` stays in force",
    ),
    Trip(
        r"^slow loop: ",
        "slow loop: no decision for three slow periods",
        "the machine is overloaded",
        "reduce its load, or set `realtime.priority`",
    ),
    Trip(
        r"^second broker client: ",
        "second broker client: …",
        "another client has this daemon's client id, or publishes as this drive",
        "end the second daemon",
    ),
    Trip(
        r"^command cannot be sent: the controller gave ",
        "command cannot be sent: the controller gave k = nan S, …",
        "the controller gave a value that is not finite",
        "keep the session for a bug report; `reset` restarts the controller",
    ),
    Trip(
        r"^command cannot be sent: ",
        "command cannot be sent: …",
        "a value does not fit its signal on the bus",
        "compare the limits of the signals in the DBC with `[drive.limits]`",
    ),
    Trip(
        r"^internal error: ",
        "internal error: …; keep the log for a report",
        "an error in the daemon; it sends the safe command and ends",
        "keep the log and the session for a bug report; the service manager restarts the daemon in "
        "`standby`",
    ),
)


def remedy(text: str) -> str:
    """Return the steps that remove the cause of a trip as plain text, empty for an unknown cause.

    Args:
        text: Text of the trip.
    """
    return next((trip.remedy for trip in TRIPS if re.search(trip.sign, text)), "").replace("`", "")
