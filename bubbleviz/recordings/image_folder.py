"""Depth images of a folder as frames: arrays of depth or of points, 16-bit PNG and TIFF."""

from __future__ import annotations

import csv
import json
import re
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image
from pydantic import ConfigDict

from bubbleviz.camera import MAX_SIDE, ColourImage, EncodedImage, Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.files import (
    as_input_error,
    checked,
    named_file,
    presets_folder,
    read_npy,
    read_toml,
)
from bubbleviz.recordings.colour_topics import colour_camera
from bubbleviz.recordings.depth_topics import PRESSURE, WRENCH
from bubbleviz.recordings.frame import Frame, check_index
from bubbleviz.recordings.message_decoding import MAX_STAMP_NS, metres, project_points
from bubbleviz.recordings.recorded_colour import ColourAround, half_step_ns
from bubbleviz.recordings.time_series import Moment, Series, values_at
from bubbleviz.sensor import Lens
from bubbleviz.wording import count_of, width_by_height

SUFFIXES = (".npy", ".png", ".tif", ".tiff")
_INTRINSICS = ("intrinsics.toml", "intrinsics.json")
"""Names under which intrinsics are looked for in folders."""
MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 10.0
"""Range of the median depth of a camera inside a bubble; outside it the unit is wrong."""
MIN_GAS_PA, MAX_GAS_PA = 20e3, 1e6
"""Range of the absolute gas pressure of a bubble: else another unit, or a gauge pressure."""
FOLDERS = ("color", "colour", "rgb")  # names of a subfolder of colour images
_COLOUR_ENCODINGS = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
_MILLIMETRE = 1e-3
_NANOSECONDS = 1e17  # stamps beyond it are in ns since 1970, below it in s


class ImageFolder:
    """Frames of the images in a folder, in the order of the numbers in their names.

    A subfolder `color` (`colour`, `rgb`) has the colour images, JPEG or PNG, of the depth images
    with the same last number, and `intrinsics.toml` or `.json` of their camera.

    Raises InputError: no images, or images and times do not match.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        # TOML or JSON with the keys of a sensor file's camera, or a preset; None: the file of the
        # folder, else those of the sensor file are used
        intrinsics: str | Path | None = None,
        # CSV of a time for each image, s, on the clock of the other measurements; None: the file of
        # the folder
        times: str | Path | None = None,
        # instead of times; without either, file names are time stamps in s or ns
        rate_hz: float | None = None,
        # of the pixels' values: 0.001 for whole numbers, 1 for others where it is not given
        metres_per_unit: float | None = None,
        gas_pressure: str | Path | None = None,  # CSV of time and absolute pressure in Pa
        wrench: str | Path | None = None,  # CSV of time, three forces in N, three torques in N·m
    ) -> None:
        self.path = Path(folder)
        self.name = self.path.name
        if rate_hz is not None and times is not None:
            raise InputError(f"{folder}: give either --rate or --times, not both")
        self._intrinsics, self._scale = _intrinsics_in(self.path, intrinsics), metres_per_unit
        self._series = {}
        if gas_pressure is not None:
            self._series[PRESSURE] = _gas_pressure(gas_pressure)
        if wrench is not None:
            self._series[WRENCH] = _measured(wrench, _columns(wrench, 7))
        found = [path for path in self.path.iterdir() if path.suffix.lower() in SUFFIXES]
        if not found:
            raise InputError(
                f"{folder}: no depth images; put {', '.join(SUFFIXES)} files into it, or choose "
                "another folder"
            )
        self._files = sorted(found, key=lambda path: (_numbers(path.stem), path.name))
        self._clock_s = self._checked_times(times, rate_hz)
        self.times_s = self._clock_s - self._clock_s[0]
        for kind, each in self._series.items():
            if all(each.at(self._moment(k)) is None for k in range(len(self))):
                what = {PRESSURE: "gas pressures", WRENCH: "wrenches"}[kind]
                raise InputError(
                    f"{self.path}: none of the {what} has the time of an image; give both times in "
                    "s by the same clock"
                )
        self._colour = self._find_colour()
        first = self._pixels(self._files[0])
        self._shape = first.shape
        # whether depths are whole numbers of mm
        self.whole_millimetres = first.dtype.kind in "ui" and metres_per_unit in (None, _MILLIMETRE)
        self._check()

    def _checked_times(self, times: str | Path | None, rate_hz: float | None) -> np.ndarray:
        """Times of the images, (F,), s: as given, by the rate, or from the file names."""
        if rate_hz is not None:
            stamps = np.arange(len(self._files)) / rate_hz
        elif file := times or _existing(self.path, "times.csv"):
            stamps = _columns(file, 1)[:, 0]
        else:
            stamps = self._stamps()
        if len(stamps) != len(self._files):
            images, times = count_of(len(self._files), "image"), count_of(len(stamps), "time")
            raise InputError(
                f"{self.path}: {images} but {times}; give one time for each image (--times, or "
                "times.csv in the folder)"
            )
        if not (np.abs(stamps) < 1e-9 * MAX_STAMP_NS).all():
            raise InputError(
                f"{self.path}: a time is beyond ±2³¹ s; give the times in s since 1970 or since "
                "the start (file names may also be in ns)"
            )
        if np.any(np.diff(stamps) <= 0.0):
            late = int(np.argmax(np.diff(stamps) <= 0.0)) + 1
            raise InputError(
                f"{self._files[late]}: its time is not after that of the image before; correct the "
                "times, or the numbers in the file names"
            )
        return np.asarray(stamps, dtype=np.float64)

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, InputError if it cannot be read."""
        check_index(index, self)
        time_s, moment = float(self.times_s[index]), self._moment(index)
        colour = None
        if self._colour is not None:
            within_ns = half_step_ns(1e9 * self.times_s)
            colour = ColourAround(self._colour, moment, time_s, within_ns)
        return Frame(
            index=index,
            time_s=time_s,
            depth_m=self._depth(self._files[index]),
            intrinsics=self._intrinsics,
            stamp_ns=moment.stamp_ns,
            find_colour=colour,
            **values_at(self._series, moment),
        )

    def close(self) -> None:
        """Do nothing."""

    def _moment(self, index: int) -> Moment:
        stamp_ns = round(float(self._clock_s[index]) * 1e9)
        return Moment(stamp_ns, stamp_ns)

    def _find_colour(self) -> Series[ColourImage] | None:
        """Colour images with the same numbers, from a subfolder."""
        folder = next((self.path / name for name in FOLDERS if (self.path / name).is_dir()), None)
        if folder is None:
            return None
        intrinsics = _intrinsics_in(folder)
        camera = colour_camera(intrinsics, None, own=intrinsics is not None)
        files: dict[float | None, Path] = {}
        for path in sorted(folder.iterdir()):
            number = _number(path.stem)
            if path.suffix.lower() not in _COLOUR_ENCODINGS or number is None:
                continue
            if number in files:
                raise InputError(
                    f"{path}: this colour image has the same number as {files[number].name}; "
                    "remove or renumber one"
                )
            files[number] = path
        numbers = [_number(path.stem) for path in self._files]
        frames = [k for k, number in enumerate(numbers) if number in files]
        if not frames:
            raise InputError(
                f"{folder}: no JPEG or PNG has the same last number in its name as a depth image; "
                "add or rename colour images, or remove this folder"
            )
        stamps = [self._moment(k).stamp_ns for k in frames]

        def image(k: int) -> ColourImage:
            read = partial(_read_colour, files[numbers[frames[k]]])
            return ColourImage(read, stamps[k], camera=camera)

        return Series(stamps, image)

    def _depth(self, path: Path) -> np.ndarray:
        pixels = self._pixels(path)
        if pixels.shape != self._shape:
            raise InputError(
                f"{path}: {width_by_height(pixels.shape)} pixels, the first image has "
                f"{width_by_height(self._shape)}; keep images of one size in the folder"
            )
        usual = _MILLIMETRE if pixels.dtype.kind in "ui" else 1.0
        with np.errstate(over="ignore", invalid="ignore"):  # out of range: no return
            depth = (pixels * (self._scale or usual)).astype(np.float32)
        if (depth < 0).sum() > (depth > 0).sum():
            raise InputError(
                f"{path}: most depths are negative; reverse their sign, as z points away from the "
                "camera"
            )
        return metres(depth, 1.0)

    def _pixels(self, path: Path) -> np.ndarray:
        """Pixels (H, W) of a file; of points (H, W, 3) their z, points (n, 3) are projected."""
        pixels = _read(path)
        if pixels.ndim == 3 and pixels.shape[2] == 3 and pixels.dtype.kind == "f":
            return pixels[:, :, 2]
        if pixels.ndim == 2 and pixels.shape[1] == 3 and pixels.dtype.kind == "f":
            if self._intrinsics is None:
                raise InputError(
                    f"{path}: unorganised points need the camera's intrinsics to become an image; "
                    "give them (--intrinsics), or put an intrinsics.toml into the folder"
                )
            return project_points(pixels.astype(np.float64), self._intrinsics)
        if pixels.ndim != 2 or pixels.dtype.kind not in "uif" or pixels.dtype.itemsize < 2:
            raise InputError(
                f"{path}: an array of shape {pixels.shape} and type {pixels.dtype} is not a depth "
                "image; export one channel of 16-bit or floating-point numbers, or points x, y, z"
            )
        return pixels

    def _check(self) -> None:
        camera = self._intrinsics
        if camera is not None and (camera.height, camera.width) != self._shape:
            raise InputError(
                f"{self._files[0]}: {width_by_height(self._shape)} pixels, the intrinsics are for "
                f"{camera.width}×{camera.height}; give the intrinsics of these images"
            )
        depth = self._depth(self._files[0])
        returns = depth[np.isfinite(depth)]
        middle = float(np.median(returns)) if returns.size else MIN_DEPTH_M
        if not MIN_DEPTH_M <= middle <= MAX_DEPTH_M:
            raise InputError(
                f"{self._files[0]}: the median depth {middle:.4g} m is not between "
                f"{MIN_DEPTH_M:g} and {MAX_DEPTH_M:g} m; correct the unit (--metres-per-unit), the "
                "depth in m of a pixel value of 1"
            )

    def _stamps(self) -> np.ndarray:
        """Times from the names, s."""
        numbers = [_numbers(path.stem) for path in self._files]
        last = np.array([each[-1] if each else np.nan for each in numbers])
        if not np.isfinite(last).all() or last[0] < 1e6:  # counts, not times
            raise InputError(
                f"{self.path}: the file names are not times in s or ns; give the rate of the "
                "images (--rate), or put a times.csv with the time of each in s into the folder"
            )
        if last[0] < _NANOSECONDS:
            return last
        # whole ns do not fit a float: from the first on they do
        exact = [int(re.findall(r"\d+", path.stem)[-1]) for path in self._files]
        return 1e-9 * exact[0] + 1e-9 * np.array([value - exact[0] for value in exact])


def is_image_folder(path: str | Path) -> bool:
    """Whether a path is a readable folder with images."""
    path = Path(path)
    try:
        return path.is_dir() and any(each.suffix.lower() in SUFFIXES for each in path.iterdir())
    except OSError:
        return False


def _read_intrinsics(path: str | Path) -> Intrinsics:
    """Intrinsics from a TOML or JSON file with the keys of a sensor file, or from a preset.

    The keys are in a table `camera` or at the top.

    Raises InputError: the file cannot be read, or a number is missing.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        with as_input_error(path, "the JSON file", "correct the file or its path"):
            table = json.loads(path.read_text(encoding="utf-8"))
    else:
        path = named_file(path, presets_folder("sensors"), "file of intrinsics")
        table = read_toml(path)
    camera = table.get("camera", table) if isinstance(table, dict) else table
    return Intrinsics(**checked(_Lens, camera, path, "intrinsics").model_dump())


def _intrinsics_in(folder: Path, given: str | Path | None = None) -> Intrinsics | None:
    """Intrinsics from a file, by default that of a folder; None without either."""
    file = given or _existing(folder, *_INTRINSICS)
    return _read_intrinsics(file) if file else None


def _existing(folder: Path, *names: str) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _gas_pressure(path: str | Path) -> Series[np.ndarray]:
    """Absolute gas pressure over time: a CSV of time in s and pressure in Pa.

    Raises InputError: the file cannot be read, or its numbers are not absolute pressures in Pa.
    """
    table = _columns(path, 2)
    usual = float(np.median(table[:, 1]))
    if not MIN_GAS_PA <= usual <= MAX_GAS_PA:
        raise InputError(
            f"{path}: the median gas pressure {usual:.5g} Pa is not between {MIN_GAS_PA:,.0f} and "
            f"{MAX_GAS_PA:,.0f} Pa; give absolute pressures in Pa"
        )
    return _measured(path, table)


class _Lens(Lens):
    model_config = ConfigDict(extra="ignore")  # other keys of a sensor file


def _measured(path: str | Path, table: np.ndarray) -> Series[np.ndarray]:
    if not (np.abs(table[:, 0]) < 1e-9 * MAX_STAMP_NS).all() or np.any(np.diff(table[:, 0]) <= 0.0):
        raise InputError(
            f"{path}: the first column does not increase or is beyond ±2³¹ s; give times in s, in "
            "order"
        )
    return Series([round(1e9 * t) for t in table[:, 0]], table[:, 1:].__getitem__)


def _columns(path: str | Path, count: int) -> np.ndarray:
    with as_input_error(path, "the CSV of numbers", "correct the file or its path"):
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
        if rows and not _is_number(rows[0][0]):
            rows = rows[1:]
        padded = [(row + ["nan"] * count)[:count] for row in rows]  # short rows are refused below
        table = np.array([[float(value) for value in row] for row in padded])
    if table.ndim != 2 or table.shape[1] != count or not np.isfinite(table).all():
        finite = count_of(count, "finite number")
        raise InputError(
            f"{path}: no rows, or a row without {finite}; write {count_of(count, 'number')}, "
            "separated by commas, into each row"
        )
    return table


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(stem: str) -> tuple[float, ...]:
    return tuple(float(number) for number in re.findall(r"\d+(?:\.\d+)?", stem))


def _number(stem: str) -> float | None:
    """The number of an image, the last one in its name."""
    return next(reversed(_numbers(stem)), None)


def _read(path: Path) -> np.ndarray:
    remedy = "export it again as PNG, TIFF or .npy"
    with as_input_error(path, "the image", remedy), path.open("rb") as file:
        if path.suffix.lower() == ".npy":
            return read_npy(file, path.stat().st_size)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of tags that Pillow skips
            # by content, not by name: some formats run other programs, such as EPS
            with Image.open(file, formats=("PNG", "TIFF")) as image:
                if max(image.size) > MAX_SIDE:
                    raise ValueError(
                        f"{image.width}×{image.height} pixels are more than {MAX_SIDE} a side"
                    )
                return np.asarray(image)


def _read_colour(path: Path) -> EncodedImage:
    with as_input_error(path, "the colour image", "export it again"):
        return EncodedImage(_COLOUR_ENCODINGS[path.suffix.lower()], path.read_bytes())
