"""Sources of forces: gauges on a serial line, a table that grows, a scale that a person reads."""

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.bench.devices import DeviceError
from palpate.errors import InputError, quoted
from palpate.optional_imports import late_import
from palpate.records import FORCE_UNITS

# A gauge is silent after so long [s]; its lines are refused after so many that are none of its own.
_SILENT, _GARBAGE = 2.0, 5
# Longest piece of a line or table that is kept for the next call [bytes].
_LONGEST = 65536
# Where serial lines are shown, and their names.
_DEVICES, _PORTS = "/dev", ("ttyUSB*", "ttyACM*", "tty.usb*")
_NUMBER = rb"(?P<value>[-+]?\d+(?:\.\d*)?|[-+]?\.\d+)"
Readings = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


@dataclass(frozen=True, slots=True)
class SerialProtocol:
    """How a gauge speaks.

    Attributes
    ----------
    reading : bytes                 pattern of one reading with a group `value`, and `unit` or
                                    `sign` where it has them; `over`: the gauge is overloaded
    request : bytes                 what asks for one reading; empty: it sends by itself
    baud : int                      as it is when bought
    units : mapping                 how it writes units, where not as `FORCE_UNITS` does
    """

    reading: bytes
    request: bytes = b""
    baud: int = 9600
    units: dict[str, str] | None = None


# A gauge more is one line more. From the makers' manuals: Mark-10 series 3 to 7 (GCL), IMADA DST
# and DSV, Sauter FH (sign first: 0 is pressure; no line ends). HX711 boards send a number a line.
GAUGES = {
    "mark-10": SerialProtocol(
        _NUMBER + rb" *(?P<unit>lbF|ozF|kgF|gF|N|kN|mN)?\r\n",
        b"?\r",
        115200,
        {"lbF": "lbf", "kgF": "kgf", "gF": "gf"},
    ),
    "imada": SerialProtocol(
        _NUMBER + rb"(?P<unit>[OKN])[TP](?:(?P<over>E)|[LOH])\r",
        b"D\r",
        19200,
        {"O": "lbf", "K": "kgf"},
    ),
    "sauter": SerialProtocol(rb"(?P<sign>[01])(?P<value>[\d.]{6})", b"9"),
    "hx711": SerialProtocol(_NUMBER + rb" *(?P<unit>kgf|gf|mN|N)?\r?\n", baud=115200),
}


def shown_ports() -> list[str]:
    """Serial lines of USB adapters and boards that Linux and macOS show as files."""
    return sorted(str(file) for pattern in _PORTS for file in Path(_DEVICES).glob(pattern))


def _spread(since: float, now: float, count: int) -> Float[np.ndarray, " n"]:
    """Times of readings that came between two calls [s]. With one time for all of them the noise of
    the force would be lost: what lies between two calls would be a straight line."""
    return now - (now - since) * np.arange(count)[::-1] / max(count, 1)


class SerialGauge:
    """A gauge on a serial line or USB adapter. What has come since the last call is spread over the
    time since then.

    Parameters
    ----------
    port : str                      such as /dev/ttyUSB0 or COM3
    gauge : str                     a key of `GAUGES`
    unit : str or None              key of `FORCE_UNITS`; None: as each reading says
    limit : float [N] or None       end of its range
    baud : int or None              None: the gauge's usual one

    Raises
    ------
    InputError                      pyserial is missing
    """

    typed = False

    def __init__(
        self, port: str, gauge: str, *, unit: str | None = None, limit: float | None = None,
        baud: int | None = None,
    ) -> None:  # fmt: skip
        self.port, self.gauge, self.unit, self.limit = port, gauge, unit, limit
        self.protocol = GAUGES[gauge]
        self.baud = baud or self.protocol.baud
        self._line: Any = None
        self._rest = b""
        self._heard = self._called = 0.0
        self._pattern = re.compile(self.protocol.reading)

    def start(self) -> None:
        """As in `ForceSource`."""
        serial = late_import("serial", extra="gauge", purpose="a gauge on a serial line")
        self.close()
        try:
            self._line = serial.Serial(self.port, self.baud, timeout=0.0, write_timeout=1.0)
        except (serial.SerialException, ValueError) as error:
            raise self._error(f"cannot be opened ({error})") from error
        self._rest, self._heard = b"", time.monotonic()
        self._called = self._heard
        self._ask()

    def read(self) -> Readings:
        """As in `ForceSource`."""
        serial = late_import("serial", extra="gauge", purpose="a gauge on a serial line")
        try:
            arrived = self._line.read(_LONGEST)
            now = time.monotonic()
            self._rest = (self._rest + arrived)[-_LONGEST:]
            newtons, end = [], 0
            for match in self._pattern.finditer(self._rest):
                newtons.append(self._newtons(match))
                end = match.end()
            self._check(len(newtons), end, now)
            self._rest = self._rest[end:]
            if newtons:
                self._ask()
        except (serial.SerialException, OSError) as error:
            raise self._error(f"has gone ({error})") from error
        since, self._called = self._called, now
        return _spread(since, now, len(newtons)), np.array(newtons)

    def close(self) -> None:
        """As in `ForceSource`."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def _ask(self) -> None:
        if self.protocol.request:
            self._line.write(self.protocol.request)

    def _newtons(self, match: "re.Match[bytes]") -> float:
        groups = {name: text.decode() for name, text in match.groupdict().items() if text}
        if "over" in groups:
            raise self._error("is overloaded; press less deep, or take one of a larger range")
        known = self.protocol.units or {}
        sent_unit = groups.get("unit")
        sent_unit = None if sent_unit is None else known.get(sent_unit, sent_unit)
        unit = self.unit or sent_unit
        if unit is None:
            raise self._error("sends numbers without a unit; say it as `unit` in [force]")
        if sent_unit is not None and sent_unit != unit:
            raise self._error(
                f"sends {sent_unit}, and [force] says {unit}; switch the gauge, or correct `unit`"
            )
        if unit not in FORCE_UNITS:
            raise self._error(f"sends {unit}; switch it to one of {', '.join(FORCE_UNITS)}")
        sign = -1.0 if groups.get("sign") == "0" else 1.0
        return sign * FORCE_UNITS[unit] * float(groups["value"])

    def _check(self, count: int, end: int, now: float) -> None:
        """Refuse a gauge that is silent or speaks another language."""
        if count:
            self._heard = now
            return
        if self._rest.count(b"\n") + self._rest.count(b"\r") >= _GARBAGE:
            raise self._error(
                f"sends {quoted(self._rest[-40:])}, which is no reading of '{self.gauge}': is it"
                f" another gauge ({', '.join(GAUGES)}), or another baud rate than {self.baud}?"
            )
        if now - self._heard > _SILENT:
            raise self._error(
                f"has sent no reading for {_SILENT:g} s: is it on, is `port` right, and is its"
                f" baud rate {self.baud}?"
            )

    def _error(self, what: str) -> DeviceError:
        return DeviceError(f"the gauge '{self.gauge}' at {self.port} {what}")


class TableGauge:
    """A table that another program writes line by line: its last column is the force. What is in it
    before the start is left out; what has come since the last call is spread over the time since
    then.

    Parameters
    ----------
    file : Path
    unit : str                      key of `FORCE_UNITS`
    limit : float [N] or None       end of the gauge's range
    """

    typed = False

    def __init__(self, file: Path, *, unit: str = "N", limit: float | None = None) -> None:
        self.file, self.unit, self.limit = file, unit, limit
        self._place = 0
        self._heard = self._called = 0.0

    def start(self) -> None:
        """As in `ForceSource`."""
        try:
            self._place = self.file.stat().st_size
        except OSError as error:
            raise DeviceError(
                f"{self.file}: cannot be read ({error.strerror}); start the program that writes it"
            ) from error
        self._heard = self._called = time.monotonic()

    def read(self) -> Readings:
        """As in `ForceSource`."""
        now = time.monotonic()
        try:
            with self.file.open("rb") as table:
                table.seek(self._place)
                text = table.read(_LONGEST)
        except OSError as error:
            raise DeviceError(f"{self.file}: cannot be read ({error.strerror})") from error
        whole = text[: text.rfind(b"\n") + 1]
        self._place += len(whole)
        try:
            values = [float(re.split(rb"[,;\t ]+", line)[-1]) for line in whole.split(b"\n")[:-1]]
        except ValueError:
            raise DeviceError(
                f"{self.file}: {quoted(whole[-60:])} does not end in a number; the last column of"
                " each line must be the force"
            ) from None
        if values:
            self._heard = now
        elif now - self._heard > _SILENT:
            raise DeviceError(
                f"{self.file}: has had no new line for {_SILENT:g} s; is the program that writes it"
                " running, and does it write each line at once?"
            )
        since, self._called = self._called, now
        return _spread(since, now, len(values)), FORCE_UNITS[self.unit] * np.array(values)

    def close(self) -> None:
        """As in `ForceSource`."""


class TypedForce:
    """A gauge or a kitchen scale that a person reads.

    Parameters
    ----------
    unit : str                      of a number without one, e.g. "gf" for grams
    """

    typed = True
    limit: float | None = None

    def __init__(self, *, unit: str = "gf") -> None:
        self.unit = unit

    def start(self) -> None:
        """As in `ForceSource`."""

    def read(self) -> Readings:
        """Nothing: a person is asked, and `newtons` says what the answer means."""
        return np.zeros(0), np.zeros(0)

    def close(self) -> None:
        """As in `ForceSource`."""

    def newtons(self, text: str) -> float:
        """What a person typed: 320, "320 g", "0.5 kg", "3.1 N".

        Parameters
        ----------
        text : str

        Returns
        -------
        float [N]                   > 0

        Raises
        ------
        InputError                  no such number
        """
        match = re.fullmatch(r"\s*(\d+(?:[.,]\d*)?|[.,]\d+)\s*(\S*)\s*", text)
        unit = {"g": "gf", "kg": "kgf", "": self.unit}
        name = unit.get(match[2], match[2]) if match else ""
        newtons = float(match[1].replace(",", ".")) * FORCE_UNITS.get(name, 0.0) if match else 0.0
        if newtons <= 0.0:
            raise InputError(
                f"{quoted(text)} is no force; type what the scale shows more than before, with its"
                f" unit if it is not {self.unit}: 320 g, 0.5 kg, 3.1 N"
            )
        return newtons
