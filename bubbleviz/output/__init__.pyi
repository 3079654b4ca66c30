from .export_plan import ExportPlan as ExportPlan
from .exporter import Shape as Shape
from .pose_writer import (
    PoseRow as PoseRow,
    pose_columns as pose_columns,
    pose_row as pose_row,
    read_poses as read_poses,
    write_poses as write_poses,
)
from .results import (
    COLUMNS as COLUMNS,
    NODAL_FIELDS as NODAL_FIELDS,
    ResultWriter as ResultWriter,
    csv_row as csv_row,
    magnitude_half_width_n as magnitude_half_width_n,
    nodal_fields as nodal_fields,
    result_arrays as result_arrays,
    results_of as results_of,
    summary_row as summary_row,
    surface_arrays as surface_arrays,
)
from .scene import ARROW as ARROW, scene_of as scene_of
from .settings_comparison import (
    ComparedResult as ComparedResult,
    SettingsComparison as SettingsComparison,
)
from .table_export import (
    DPI as DPI,
    SIZE_IN as SIZE_IN,
    FrameTable as FrameTable,
    draw_plots as draw_plots,
)
from .video import open_mp4 as open_mp4
from .wrench_comparison import (
    Interval as Interval,
    WrenchComparison as WrenchComparison,
    compare_with_wrench as compare_with_wrench,
)
