from .meshes import SUFFIXES as SUFFIXES, read_triangles as read_triangles, write_ply as write_ply
from .output_files import (
    PICTURES as PICTURES,
    cannot_write as cannot_write,
    create_folder as create_folder,
    free_name as free_name,
    portable_path as portable_path,
    refuse_existing as refuse_existing,
    refuse_input as refuse_input,
    remove_unfinished as remove_unfinished,
    restore_on_error as restore_on_error,
    rows_of as rows_of,
    sync as sync,
    table as table,
    to_json as to_json,
    whole_file as whole_file,
    write_json as write_json,
    write_rows as write_rows,
)
from .poses import (
    COLUMNS as COLUMNS,
    angles_of_pose as angles_of_pose,
    checked_pose as checked_pose,
    is_unit as is_unit,
    parse_pose as parse_pose,
    pose_matrix as pose_matrix,
    pose_numbers as pose_numbers,
    pose_of_angles as pose_of_angles,
    read_path as read_path,
    read_rows as read_rows,
    transform as transform,
)
from .preset_files import (
    MAX_COLOUR_DELAY_S as MAX_COLOUR_DELAY_S,
    SESSION_SUFFIX as SESSION_SUFFIX,
    SYNTHETIC_SENSOR as SYNTHETIC_SENSOR,
    TRUTH_SUFFIX as TRUTH_SUFFIX,
    pages_folder as pages_folder,
    preset_names as preset_names,
    presets_folder as presets_folder,
)
from .reading import (
    as_input_error as as_input_error,
    exists as exists,
    file_hash as file_hash,
    plain_numbers as plain_numbers,
    read_npy as read_npy,
    read_npz as read_npz,
)
from .toml_files import checked as checked, named_file as named_file, read_toml as read_toml
