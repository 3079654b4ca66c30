"""Atmospheric pressure by the gas pressure sensor itself, its chamber open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rest.noise_correlation import error_of_mean
from bubbleviz.errors import InputError
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of

_FEWEST = 5  # frames whose mean and spread say something; chosen


@dataclass(frozen=True)
class Vented:
    """Gas pressure of the open chamber: an offset of the sensor is the same with it closed.

    Attributes
    ----------
    source_name : str
    pressure_pa : float
        Absolute, Pa.
    sigma_pa : float
        Standard error, Pa.
    """

    source_name: str
    pressure_pa: float
    sigma_pa: float

    @classmethod
    def measure(cls, source: FrameSource) -> Vented:
        """Mean over all frames of a recording.

        Raises
        ------
        InputError
            Fewer than five frames with a gas pressure.
        """
        values = [source[k].gas_pressure_pa for k in range(len(source))]
        known = np.array([value for value in values if value is not None])
        if len(known) < _FEWEST:
            raise InputError(
                f"{source.name}: {count_of(len(known), 'frame')} with a gas pressure; --vented"
                f" needs {_FEWEST}: record the sensor with its chamber open"
            )
        return cls(source.name, float(np.mean(known)), error_of_mean(known))

    def set_in(self, sensor: Sensor) -> Sensor:
        """The sensor with this atmospheric pressure."""
        section = sensor.pneumatics.model_copy(
            update={
                "atmospheric_pressure_pa": round(self.pressure_pa, 1),
                "gauge_sigma_pa": None,  # of a gauge pressure told by something else
            }
        )
        return sensor.model_copy(update={"pneumatics": section})
