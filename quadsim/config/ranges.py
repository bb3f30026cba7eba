"""Types of the numbers in a configuration, each with its unit and range.

The ranges are wide. A value outside its range is a typing error or has the wrong unit.
"""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Annotated, Any, Literal, TypeAlias, get_args

from pydantic import AfterValidator, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


@dataclass(frozen=True)
class Between:
    """A closed range and its unit, which appears in the error message for a number outside the range."""

    low: float
    high: float
    unit: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check a number after pydantic's own checks."""
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def check(self, value: float) -> float:
        """Return the value if it is in the range.

        Raises:
            ValueError: The value is outside the range.
        """
        if self.low <= value <= self.high:
            return value
        ends = f"{self.low:g} to {self.high:g} {self.unit}".rstrip()
        near = "" if value != value else f"; the nearest is {min(max(value, self.low), self.high):g}"
        raise ValueError(f"should be {ends}{near}")

    def of(self, name: str, value: float) -> float:
        """Return the value of the named argument if it is in the range.

        Raises:
            ValueError: The value is outside the range or not a number.
        """
        if not isinstance(value, Real):
            raise ValueError(f"{name} = {value!r}: should be a number")
        try:
            return self.check(value)
        except ValueError as error:
            raise ValueError(f"{name} = {value}: {error}") from None


SAMPLE_RATE = Between(1e-3, 1e5, "Hz")
SAMPLES = Between(1, 4_000_000, "samples")
"""Number of samples in a flight."""


RATE_MAX = math.radians(4000.0)
"""Largest body rate of an axis that counts as a reading [rad/s]: the range of TDK's ICM-20649."""
FORCE_MAX = 32.0 * 9.80665
"""Largest specific force of an axis that counts as a reading [m/s²]: 30 g, the range of the ICM-20649,
rounded up."""
ROTOR_SPEED_MAX = 1e4
"""Largest rotor speed that counts as a reading [rad/s]: 95 000 rpm, faster than any propeller."""


def steps_of(duration_s: float, rate_hz: float) -> int:
    """Return the number of samples in a flight.

    Args:
        duration_s: Length of the flight [s].
        rate_hz: Samples per second.

    Raises:
        ValueError: The rate is out of range, or the flight has no samples or too many.
    """
    SAMPLE_RATE.of("rate_hz", rate_hz)
    longest = SAMPLES.high / rate_hz
    Between(0.5 / rate_hz, longest, f"s (1 to {SAMPLES.high:g} samples)").of("duration_s", duration_s)
    return max(1, min(round(duration_s * rate_hz), int(SAMPLES.high)))


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("should be the least and then the largest")
    return ends


Rising = AfterValidator(_rising)
"""Validates a pair: the smallest and the largest value that can be drawn."""

Share: TypeAlias = Annotated[float, Between(0.0, 1.0)]
SampleRate: TypeAlias = Annotated[float, SAMPLE_RATE]
Frequency: TypeAlias = Annotated[float, Between(1e-3, 1e5, "Hz")]

Instant: TypeAlias = Annotated[float, Between(0.0, 86400.0, "s")]
"""A time after the start, or a duration that may be zero."""
Duration: TypeAlias = Annotated[float, Between(1e-3, 86400.0, "s")]
Delay: TypeAlias = Annotated[float, Between(0.0, 1.0, "s")]

COORDINATE = Between(-1e4, 1e4, "m")
Coordinate: TypeAlias = Annotated[float, COORDINATE]
Position: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Distance: TypeAlias = Annotated[float, Between(1e-3, 1e4, "m")]
_ArmPart: TypeAlias = Annotated[float, Between(-5.0, 5.0, "m")]
Arm: TypeAlias = tuple[_ArmPart, _ArmPart, _ArmPart]
"""Distance from the centre of mass to a part of the vehicle."""
Size: TypeAlias = Annotated[float, Between(1e-3, 5.0, "m")]

Speed: TypeAlias = Annotated[float, Between(0.0, 100.0, "m/s")]
_WindPart: TypeAlias = Annotated[float, Between(-100.0, 100.0, "m/s")]
Wind: TypeAlias = tuple[_WindPart, _WindPart, _WindPart]
"""Velocity of the air. Only tornadoes are faster than the limit."""

Heading: TypeAlias = Annotated[float, Between(-3600.0, 3600.0, "°")]
_Turn: TypeAlias = Annotated[float, Between(-360.0, 360.0, "°")]
Rotation: TypeAlias = tuple[_Turn, _Turn, _Turn]
PeakTilt: TypeAlias = Annotated[float, Between(0.1, 55.0, "°")]
"""Tilt that a trajectory commands; the controller limits the tilt to 60°."""
RateDeg: TypeAlias = Annotated[float, Between(0.0, 4000.0, "°/s")]
Force: TypeAlias = Annotated[float, Between(0.0, 1000.0, "m/s²")]
_ForcePart: TypeAlias = Annotated[float, Between(-1000.0, 1000.0, "m/s²")]
ForceVector: TypeAlias = tuple[_ForcePart, _ForcePart, _ForcePart]

Mass: TypeAlias = Annotated[float, Between(1e-3, 1000.0, "kg")]
RotorSpeed: TypeAlias = Annotated[float, Between(1.0, 1e5, "rad/s")]

Engine = Literal["auto", "mujoco"]
"""Integrator of the motion: MuJoCo, or "auto", a compiled version of MuJoCo's scheme for a free body where
possible."""
ENGINES: tuple[Engine, ...] = get_args(Engine)
