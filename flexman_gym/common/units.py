"""Headers of columns: names, units in their many spellings, and columns that are no readings."""

import math
import re
from itertools import pairwise

DEGREE = math.pi / 180.0
# Unit -> SI unit and conversion factor.
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9), "min": ("s", 60.0),
    "N m": ("N m", 1.0), "Nm": ("N m", 1.0), "mN m": ("N m", 1e-3), "kN m": ("N m", 1e3),
    "N": ("N", 1.0), "mN": ("N", 1e-3), "kN": ("N", 1e3),
    "rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "deg": ("rad", DEGREE),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", DEGREE), "rpm": ("rad/s", math.pi / 30.0),
    "rad/s^2": ("rad/s^2", 1.0), "deg/s^2": ("rad/s^2", DEGREE),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6),
    "m/s": ("m/s", 1.0), "cm/s": ("m/s", 1e-2), "mm/s": ("m/s", 1e-3),
    "m/s^2": ("m/s^2", 1.0), "mm/s^2": ("m/s^2", 1e-3), "g": ("m/s^2", 9.80665), "mg": ("m/s^2", 9.80665e-3),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0), "mV": ("V", 1e-3), "uV": ("V", 1e-6),
    "J": ("J", 1.0), "1": ("1", 1.0), "um/m": ("1", 1e-6),
}  # fmt: skip
_SPELLINGS = {  # unit -> other spellings, without regard to capital letters
    "s": "sec secs second seconds sekunde sekunden", "ms": "msec msecs millis millisecond milliseconds",
    "us": "usec usecs micros microsecond microseconds", "ns": "nsec nsecs nanos nanosec nanosecond nanoseconds",
    "min": "minute minutes", "Nm": "n-m n.m newton_meter newton_metre", "mN m": "mnm mn-m", "kN m": "knm kn-m",
    "N": "newton newtons", "rad": "radian radians", "deg": "degree degrees", "deg/s": "dps deg/sec degrees/s",
    "rad/s": "rad/sec rads/s radians/s", "rad/s^2": "rad/s2 rad/sec^2 rad/s/s", "deg/s^2": "deg/s2 deg/sec^2 deg/s/s",
    "rpm": "1/min r/min rev/min", "m": "meter meters metre metres", "mm": "millimeter millimeters millimetre",
    "m/s": "m/sec meters/s", "m/s^2": "m/s2 m/sec^2 m/sec2 m/s/s ms-2 ms^-2 m.s-2 m.s^-2 m_s-2 m_s^-2 meters/s^2",
    "mm/s^2": "mm/s2 mm/sec^2 mm/s/s", "g": "gs g0 g_n", "A": "amp amps ampere amperes", "V": "volt volts",
    "um/m": "ustrain microstrain ue", "1": "strain m/m",
}  # fmt: skip
_ALIASES = {name: unit for unit, names in _SPELLINGS.items() for name in names.split()}
_ALIASES |= {unit.lower(): unit for unit in UNITS if unit not in ("mN", "mN m", "Nm", "N")}
_SYMBOLS = {"**": "^", "*": " ", "·": " ", "²": "^2", "µ": "u", "μ": "u", "°": "deg", "ε": "e", "⁻": "-"}  # noqa: RUF001
_ENDINGS = {  # last parts of a name such as acc_m_s2 -> unit; shorter ones, such as m, are parts of names
    "rad": "rad", "mrad": "mrad", "deg": "deg", "mm": "mm", "nm": "Nm", "dps": "deg/s", "rad s": "rad/s",
    "deg s": "deg/s", "m s2": "m/s^2", "m s 2": "m/s^2", "mps2": "m/s^2", "rpm": "rpm",
}  # fmt: skip
_BRACKETS = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
_AFTER = re.compile(r"^(?P<name>.*\S)(?:\s*,\s*|\s+/\s+|\s+in\s+)(?P<unit>\S[^,]*)$")
_PARTS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
COMMANDS = frozenset((  # parts of the name of a command, a set point or a temperature
    "target", "cmd", "cmds", "command", "commands", "commanded", "setpoint", "setpoints", "set point", "ref",
    "reference", "desired", "des", "demand", "demanded", "goal", "input", "inputs", "tau", "pwm", "duty", "soll",
    "temperature", "temperatures", "temp", "temperatur",
))  # fmt: skip
COUNTERS = frozenset((  # names of the number of a line
    "", "index", "idx", "seq", "sequence", "sample", "samples", "sample number", "sample no", "number", "no", "nr", "n",
    "row", "line", "column", "frame", "counter", "header seq", "field header seq", "id",
))  # fmt: skip


def find_unit(text: str) -> str | None:
    """Return the unit in `UNITS` of a text such as "mN*m", "m/s²" or "sec"; None for an unknown one."""
    for symbol, plain in _SYMBOLS.items():
        text = text.replace(symbol, plain)
    text = " ".join(text.strip(" ()[]{}").split())
    found = text if text in UNITS else _ALIASES.get(text.replace(" ", "_").lower())
    return found or _ALIASES.get(text.lower())


def split_header(header: str) -> tuple[str, str]:
    """Return name and unit of a header such as "torque_1 (N m)", "Zeit in ms" or "angle_deg"; "" where missing.

    The unit is that of the file if it is in brackets, even an unknown one. Brackets with a number, as in "position[0]",
    belong to the name.
    """
    whole = " ".join(header.strip().strip("\"'").lstrip("#%").split())
    groups = [each for each in _BRACKETS.finditer(whole) if not _is_index(whole, each)]
    if groups:
        last = next((each for each in reversed(groups) if find_unit(each[1])), groups[-1])
        name = f"{whole[: last.start()].rstrip()} {whole[last.end() :].lstrip()}".strip()
        return name, find_unit(last[1]) or last[1].strip()
    after = _AFTER.match(whole)
    if after and find_unit(after["unit"]):
        return after["name"], str(find_unit(after["unit"]))
    name, slash, rest = whole.partition("/")
    if slash and name and " " not in name and find_unit(rest):
        return name, str(find_unit(rest))
    words = name_parts(whole)
    return whole, next((_ENDINGS[e] for e in (" ".join(words[-k:]) for k in (3, 2, 1)) if e in _ENDINGS), "")


def name_parts(name: str) -> list[str]:
    """Return the parts of a name in small letters: "timeStamp_us" has "time", "stamp" and "us"."""
    return [part.lower() for part in _PARTS.findall(name)]


def is_command(name: str) -> bool:
    """Return True for the name of a command, a set point or a temperature, such as target_q_1, which is no reading."""
    parts = [part for part in name_parts(name) if not part.isdigit()]
    return any(part in COMMANDS for part in [*parts, *map(" ".join, pairwise(parts))])


def is_counter(name: str) -> bool:
    """Return True for the name of a column that counts lines."""
    return " ".join(part for part in name_parts(name) if not part.isdigit()) in COUNTERS


def _is_index(header: str, group: re.Match[str]) -> bool:
    """Return True for brackets such as [0] directly behind a name."""
    return group[1].isdigit() and header[group.start()] == "[" and header[: group.start()][-1:] not in ("", " ")
