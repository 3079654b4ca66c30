"""Matching recordings with sensors: image sizes must agree; finds the preset that fits."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path, PurePosixPath

import numpy as np

from bubbleviz.errors import InputError, UnknownCameraError
from bubbleviz.files import preset_names
from bubbleviz.recordings.depth_topics import CAMERA_INFO, PRESSURE, of_type
from bubbleviz.recordings.frame import FrameSource, shown_name
from bubbleviz.recordings.message_decoding import COMPRESSED
from bubbleviz.recordings.recording import Recording, open_recording
from bubbleviz.sensor import Sensor, load_sensor, size_refusal
from bubbleviz.wording import size_text

WEATHER_PA = 5e3
"""Variation of the atmospheric pressure at one place, Pa: the extremes are ±5 kPa."""
_GAS_SAMPLE = 64  # gas pressures, evenly spread, by which their unit is judged
_OTHER_UNITS_PA = {"kPa": 1e3, "hPa": 100.0, "psi": 6_894.757, "bar": 1e5}
"""Units of pressure that sensors have, other than the message's, Pa."""
AUTO = "auto"  # sensor name that stands for the preset whose camera has the recording's image size


def image_size(source: FrameSource) -> tuple[int, int]:
    """Width and height of the depth images of a source, pixels."""
    if isinstance(source, Recording):
        return source.size
    height, width = source[0].depth_m.shape
    return width, height


def check_fits(source: FrameSource, sensor: Sensor, sensor_name: str | Path) -> None:
    """Refuse frames that are not of the sensor's camera, or with gas pressures in another unit.

    Raises InputError: the images, or the recorded camera info, have another size; or that unit.
    """
    if isinstance(source, Recording):
        _check_camera_info(source)
        if len(measured := source.gas_pressures_pa(_GAS_SAMPLE)):
            value, where = float(np.median(measured)), f" on {source.value_topics[PRESSURE]}"
            check_gas_unit(value, sensor, str(source.path), where, ", and record again")
    if (size := image_size(source)) != sensor.camera.size:
        found = f"{shown_name(source)}: images are"
        raise size_refusal(found, size, sensor_name, sensor.camera.size)


def fitting_sensor(source: FrameSource, name: str | Path | Sensor | None) -> tuple[str, Sensor]:
    """Name and sensor for frames: as given, or the preset of their size for `auto` and None.

    Raises InputError: there is no such sensor, or it does not fit the frames.
    """
    if name is None or str(name) == AUTO:
        name = preset_of_size(image_size(source), shown_name(source))
    sensor = load_sensor(name)
    shown = sensor.name if isinstance(name, Sensor) else str(name)
    check_fits(source, sensor, shown)
    return shown, sensor


def gas_warning(
    measured_pa: float | None,  # absolute, Pa, of any frame: a press adds only hundreds of Pa
    known_pa: float,  # without contact, as the sensor file has it, Pa
    where: str = "in the recording",  # it was measured
) -> str:
    """Warning if the gas pressure does not fit the sensor; else empty."""
    if measured_pa is None or abs(measured_pa - known_pa) <= WEATHER_PA:
        return ""
    return (
        f"gas pressure of {1e-3 * measured_pa:.1f} kPa (absolute) {where}, but "
        f"{1e-3 * known_pa:.1f} kPa (atmospheric plus gauge) in the sensor file: more than weather "
        "explains; record absolute pressure, correct the pressures in the sensor file, or check "
        "the pressure sensor"
    )


def checked_sensor(
    path: str | Path, name: str | Path | None, depth_topic: str | None = None
) -> tuple[str, Sensor]:
    """`fitting_sensor` of a recording that is not open yet."""
    with closing(open_recording(path, depth_topic=depth_topic)) as source:
        return fitting_sensor(source, name)


def preset_of_size(
    size: tuple[int, int],  # width and height, pixels
    images: str,  # name of the images in an error
) -> str:
    """Name of the one sensor preset whose camera has images of this size.

    Raises UnknownCameraError: no preset has, or several have.
    """
    names = preset_names("sensors")
    sizes = {name: load_sensor(name).camera.size for name in names}
    fitting = [name for name in names if sizes[name] == size]
    if len(fitting) == 1:
        return fitting[0]
    known = ", ".join(f"{name} ({size_text(sizes[name])})" for name in fitting or names)
    have = "several presets have" if fitting else "no preset has"
    choice = "one of them or the" if fitting else "the"
    raise UnknownCameraError(
        f"{images}: {have} a camera of {size_text(size)} pixels (presets: {known}); "
        f"choose {choice} sensor file of this camera (--sensor)",
        size,
    )


def _check_camera_info(recording: Recording) -> None:
    """Refuse when the only camera info in the depth topic's namespace is of another image size.

    The reader ignores camera infos of other sizes, such as a colour camera's; one in the namespace
    of the depth images means that these were cropped or scaled, so that it no longer holds.
    """
    if recording.intrinsics is not None:
        return
    topic_name = PurePosixPath(recording.depth_topic.name)
    if topic_name.name == COMPRESSED:  # a subtopic of the raw images'
        topic_name = topic_name.parent
    namespace = topic_name.parent
    for topic in of_type(recording.bag, CAMERA_INFO):
        if PurePosixPath(topic.name).parent != namespace:
            continue
        message = recording.bag.messages(topic).first()
        size = (int(message.width), int(message.height))
        if size != recording.size:
            raise InputError(
                f"{recording.path}: camera info on {topic.name} is for {size_text(size)} pixels "
                f"but the images are {size_text(recording.size)}; record both from one camera, "
                "neither cropped "
                "nor scaled"
            )


def check_gas_unit(
    value: float,  # gas pressure as measured
    sensor: Sensor,
    name: str,  # of the recording or source
    where: str = "",  # it was measured there
    then: str = "",  # what to do after mending it
) -> None:
    """Refuse a gas pressure that is the sensor file's in a unit other than Pa.

    Gauge pressures in Pa are accepted, as their changes are right. Raises InputError.
    """
    known, expected = sensor.pneumatics, sensor.pneumatics.reference_pressure_pa
    misfits = {unit: abs(pa * value - expected) for unit, pa in _OTHER_UNITS_PA.items()}
    unit = min(misfits, key=misfits.__getitem__)
    if misfits[unit] < min(WEATHER_PA, abs(value - known.gauge_pressure_pa)):
        raise InputError(
            f"{name}: gas pressure of {value:.4g}{where} is in {unit}, "
            f"not in Pa as FluidPressure messages are (near {expected:.0f} by the sensor file); "
            f"multiply it by {_OTHER_UNITS_PA[unit]:g} before publishing{then}"
        )
