"""What the window says about a sensor and its file. No Qt in here."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.session_files.session_file import name_of

PLAIN = Unit("", 1.0, 4)
NOT_THERE = "not in the file"


@dataclass(frozen=True)
class Value:
    """A number of the sensor file.

    Attributes
    ----------
    key : str
        As in `bubbleviz.sensor.edited`.
    title, tip : str
    si : str
        Unit in the file.
    unit : str
        Of `Units`; empty for a pure number.
    interval, rests_on : str
        Keys of `bubbleviz.sensor.Calibration` that tell how it was measured; empty for none.
    """

    key: str
    title: str
    tip: str
    si: str = ""
    unit: str = ""
    interval: str = ""
    rests_on: str = ""

    def unit_in(self, units: Units) -> Unit:
        """The operator's unit of it."""
        unit = getattr(units, self.unit) if self.unit else PLAIN
        assert isinstance(unit, Unit)
        return unit

    def of(self, sensor: Sensor) -> float | None:
        """The number, SI; None where the file has none."""
        number: float | None = attrgetter(self.key)(sensor)
        return number

    def text(self, sensor: Sensor, units: Units) -> str:
        """The number with its unit."""
        number = self.of(sensor)
        return NOT_THERE if number is None else self.unit_in(units).text(number).rstrip()

    def interval_text(self, sensor: Sensor, units: Units) -> str:
        """95 % interval, where the file has one."""
        unit = self.unit_in(units)
        ends = getattr(sensor.calibration, self.interval, None) if self.interval else None
        if ends is None:
            return ""
        return unit.between(*ends).rstrip()

    def origin(self, sensor: Sensor) -> str:
        """What the number rests on, where the file says so."""
        rests_on = getattr(sensor.calibration, self.rests_on, None) if self.rests_on else None
        return f"from {rests_on}" if rests_on else ""

    def written(self, sensor: Sensor) -> str:
        """The number as the file has it, without its unit."""
        number = self.of(sensor)
        return "" if number is None else str(number)

    @staticmethod
    def read(text: str) -> float | str | None:
        """The number of a text; what is none, as it was typed."""
        try:
            return float(text) if text.strip() else None
        except ValueError:
            return text


VALUES = (
    Value("pneumatics.gauge_pressure_pa", "Gauge pressure", "Of the gas above the atmosphere, "
          "without contact", "Pa", "gas_pressure", "gauge_interval_pa", "gauge_from"),
    Value("pneumatics.tension_n_per_m", "Tension γ0", "Of the membrane at rest; without one it "
          "follows from gauge pressure and curvature", "N/m", "tension",
          "tension_interval_n_per_m"),
    Value("membrane.prestretch", "Pre-stretch λ", "Of the rubber at rest; without one the tension "
          "is constant", "", "", "prestretch_interval", "prestretch_from"),
    Value("pneumatics.atmospheric_pressure_pa", "Atmosphere", "Absolute pressure outside",
          "Pa", "gas_pressure"),
    Value("pneumatics.chamber_volume_m3", "Chamber volume", "Of the gas behind the rim plane",
          "m³", "volume"),
    Value("camera.noise_relative", "Depth noise", "Standard deviation of the range, relative to it",
          "of the range", "range_share"),
    Value("camera.colour_delay_s", "Colour delay", "Stamp of a colour image minus that of the "
          "depth image of the same moment; negative where colour leads depth", "s", "time"),
)  # fmt: skip
"""In the order of the panel."""


def file_text(sensor: Sensor) -> str:
    """Where a sensor is from, in short: its file's name, `preset`, or `not saved`."""
    name = name_of(sensor)
    if name is None:
        return "not saved"
    return sensor.file if name.endswith(".toml") else "preset"


def title_text(sensor: Sensor) -> str:
    """Name and file of a sensor."""
    return f"{sensor.name} ({file_text(sensor)})"


def identified_text(sensor: Sensor) -> str:
    """When a sensor was identified, and whether its values were changed by hand since."""
    calibration = sensor.calibration
    if calibration is None:
        return "no, nominal values"
    date = calibration.date
    when = f"{date[:16].replace('T', ' ')} UTC" if date else "yes, without a date"
    return f"{when}, edited since" if calibration.edited else when
