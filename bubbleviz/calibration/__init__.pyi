from .ellipsoid import (
    Ellipsoid as Ellipsoid,
    fit_ellipsoid as fit_ellipsoid,
    fit_sphere as fit_sphere,
)
from .fit_errors import (
    tile_errors as tile_errors,
)
from .identification import (
    Identification as Identification,
    open_chamber as open_chamber,
    rest_gauge as rest_gauge,
)
from .reference_press import (
    reference_force as reference_force,
)
from .report import (
    before_after as before_after,
    local_tension_image as local_tension_image,
    output_files as output_files,
    summary as summary,
    write_sensor as write_sensor,
)
from .rest_frames import (
    Ranges as Ranges,
    as_ranges as as_ranges,
    collect as collect,
    frame_numbers as frame_numbers,
    select_pixels as select_pixels,
)
from .rim import (
    RimPlane as RimPlane,
    lateral_scale as lateral_scale,
    rim_height as rim_height,
    rim_plane as rim_plane,
)
from .rubber_problem import (
    collect_press as collect_press,
    with_rubber as with_rubber,
)
from .sensor_check import (
    CheckRow as CheckRow,
    SensorCheck as SensorCheck,
    check_sensor as check_sensor,
)
from .sensor_comparison import (
    QuantityKind as QuantityKind,
    SensorComparison as SensorComparison,
)
from .surface import (
    SURFACE_NAMES as SURFACE_NAMES,
    Quantity as Quantity,
    SurfaceName as SurfaceName,
)
from .verdict import (
    advice as advice,
    grade as grade,
    headline as headline,
    parameters as parameters,
    sentence as sentence,
)
from .workbench import (
    Settings as Settings,
    Step as Step,
    Workbench as Workbench,
    with_force as with_force,
)
