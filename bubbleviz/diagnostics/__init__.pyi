from .frame_numbers import (
    Measure as Measure,
    Numbers as Numbers,
    ShearNumbers as ShearNumbers,
    numbers_of as numbers_of,
    patch_numbers as patch_numbers,
    shear_line as shear_line,
)
from .inspector import (
    Inspection as Inspection,
    KappaCurve as KappaCurve,
    Pixel as Pixel,
    Probe as Probe,
    Probed as Probed,
    Statistics as Statistics,
    inspection as inspection,
    profile as profile,
    statistics as statistics,
)
