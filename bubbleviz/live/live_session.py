"""One or two sensors at once, each with its own source; one recorder, one clock."""

from __future__ import annotations

from dataclasses import dataclass

from bubbleviz.calibration.pressure_zero import PressureZero
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.session_preset import SensorPlace, SessionPreset
from bubbleviz.live.sinks.recorder import Recorder
from bubbleviz.live.sources.open_stream import open_stream
from bubbleviz.sensor import Sensor, load_sensor, with_colour_delay


@dataclass(frozen=True)
class LiveSensor:
    """A sensor of a session; two of them share nothing.

    Attributes
    ----------
    place : SensorPlace
        Name, colour and T_W_B.
    sensor : Sensor
    stream : LiveStream
    zero : PressureZero
        For whoever solves this sensor's frames.
    """

    place: SensorPlace
    sensor: Sensor
    stream: LiveStream
    zero: PressureZero


class LiveSession:
    """The sensors of a session preset, live; a context manager.

    Parameters
    ----------
    preset : SessionPreset
    pre_roll_s : float
        Seconds before recording starts that are recorded, too.

    Attributes
    ----------
    sensors : tuple of LiveSensor
    recorder : Recorder
        Gets every message of every sensor.

    Raises
    ------
    InputError
        A sensor file or a source is not there.
    """

    def __init__(self, preset: SessionPreset, pre_roll_s: float = 0.0) -> None:
        self.recorder = Recorder(pre_roll_s)
        self.sensors = tuple(_open(place) for place in preset.sensors)
        for each in self.sensors:
            self.recorder.listen_to(each.stream)

    def __enter__(self) -> LiveSession:
        try:
            for each in self.sensors:
                each.stream.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for each in self.sensors:
            each.stream.stop()
        if self.recorder.recording:
            self.recorder.stop()


def _open(place: SensorPlace) -> LiveSensor:
    sensor = with_colour_delay(load_sensor(place.sensor), place.colour_delay_s)
    zero = PressureZero(sensor.pneumatics.reference_pressure_pa)
    return LiveSensor(place, sensor, open_stream(place.source, sensor), zero)
