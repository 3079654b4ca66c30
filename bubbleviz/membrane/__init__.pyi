from .equilibrium import (
    RubberContact as RubberContact,
)
from .flat_sheet import (
    as_flat_sheet as as_flat_sheet,
)
from .forward_model import (
    Contact as Contact,
    ForwardModel as ForwardModel,
    GapFinder as GapFinder,
    ObstacleSolver as ObstacleSolver,
)
from .gas import (
    Gas as Gas,
    HeldPressure as HeldPressure,
)
from .inflation import (
    Inflation as Inflation,
    settled as settled,
)
from .mesh import (
    MembraneMesh as MembraneMesh,
    adjacency as adjacency,
    area_vectors as area_vectors,
    connected_parts as connected_parts,
    cotangent_laplacian as cotangent_laplacian,
    cross as cross,
    dense_part as dense_part,
    faces_from as faces_from,
    grown as grown,
    level_line as level_line,
    parts_with as parts_with,
    sums_at as sums_at,
    triangles_across as triangles_across,
)
from .meshing import (
    EllipsoidalCap as EllipsoidalCap,
    Refined as Refined,
    load_membrane as load_membrane,
    membrane_from_triangles as membrane_from_triangles,
    mesh_cap as mesh_cap,
    midway as midway,
    refined_part as refined_part,
    refinement as refinement,
    spherical_cap as spherical_cap,
)
from .object_surface import (
    MOST_TURN_RAD as MOST_TURN_RAD,
    ObjectSurface as ObjectSurface,
)
from .prestress import (
    STRESS_DEGREE as STRESS_DEGREE,
    Prestress as Prestress,
    prestressed as prestressed,
    zernike as zernike,
)
from .reference_mesh import (
    RUBBER_PARAMETERS as RUBBER_PARAMETERS,
    build_mesh as build_mesh,
    build_rubber as build_rubber,
    constant_tension_deviation as constant_tension_deviation,
    reference_tension as reference_tension,
    rubber_and_variants as rubber_and_variants,
    stiffness_changes as stiffness_changes,
)
from .rubber import (
    RubberMembrane as RubberMembrane,
    inverse_metric as inverse_metric,
)
from .rubber_forward import (
    MOST_FRICTION as MOST_FRICTION,
    RubberForward as RubberForward,
)
from .sparse_factor import (
    Factor as Factor,
    Factoriser as Factoriser,
    NodeBlocks as NodeBlocks,
    condensed as condensed,
    symmetric_lu as symmetric_lu,
)
from .stiffness import (
    balance_gradient as balance_gradient,
    balance_tension as balance_tension,
    local_tension as local_tension,
    mean_curvature as mean_curvature,
)
from .submodel import (
    Submodel as Submodel,
    Tangent as Tangent,
)
from .triangle_scene import (
    TriangleScene as TriangleScene,
)
