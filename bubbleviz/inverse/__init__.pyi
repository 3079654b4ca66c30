from .contact_problem import (
    ContactPressure as ContactPressure,
    ContactProblem as ContactProblem,
    Prior as Prior,
    Selection as Selection,
    SupportProblem as SupportProblem,
    significant_contact as significant_contact,
)
from .contact_refiner import (
    ContactRefiner as ContactRefiner,
    mesh_limits as mesh_limits,
)
from .estimator import (
    ESTIMATORS as ESTIMATORS,
    LINEAR as LINEAR,
    MAX_NODES as MAX_NODES,
    PAPER as PAPER,
    PRESSURE_SCALE as PRESSURE_SCALE,
    RIM_SLACK_M as RIM_SLACK_M,
    RUBBER as RUBBER,
    SOLVER_NAMES as SOLVER_NAMES,
    Estimator as Estimator,
    EstimatorOptions as EstimatorOptions,
)
from .friction import (
    FRICTION as FRICTION,
    contact_friction as contact_friction,
    friction_loads as friction_loads,
    prior_scale as prior_scale,
)
from .gauss_newton import (
    GaussNewton as GaussNewton,
)
from .iteration import (
    Start as Start,
)
from .measurements import (
    Measurements as Measurements,
    Nuisances as Nuisances,
)
from .paper import (
    PaperEstimator as PaperEstimator,
)
from .patch import (
    Component as Component,
    PatchFinder as PatchFinder,
    area_above as area_above,
    areas_above as areas_above,
    components as components,
    mean_pressure as mean_pressure,
    touching_share as touching_share,
    without_small as without_small,
)
from .patch_edge import (
    PatchEdge as PatchEdge,
)
from .pivoting import (
    nonnegative_qp as nonnegative_qp,
)
from .plausibility import (
    GAS_LAG as GAS_LAG,
    GAS_NOISE as GAS_NOISE,
    contradicts_measured_gas as contradicts_measured_gas,
    reason_against_fit as reason_against_fit,
    reason_against_gas as reason_against_gas,
)
from .resolution import at_noise as at_noise
from .response import (
    ConstantTension as ConstantTension,
    LinearisedRubber as LinearisedRubber,
    RubberBubble as RubberBubble,
)
from .wrench_covariance import (
    MODEL_ERROR as MODEL_ERROR,
)
