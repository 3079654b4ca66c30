from .contact_problem import (
    ContactPressure as ContactPressure,
    ContactProblem as ContactProblem,
    Nuisances as Nuisances,
    Prior as Prior,
    Ranges as Ranges,
    Selection as Selection,
    SupportProblem as SupportProblem,
    evident as evident,
    friction_loads as friction_loads,
)
from .contact_refiner import (
    ContactRefiner as ContactRefiner,
    mesh_limits as mesh_limits,
)
from .estimator import (
    MAX_LINEAR_NODES as MAX_LINEAR_NODES,
    MAX_NODES as MAX_NODES,
    PRESSURE_SCALE as PRESSURE_SCALE,
    RIM_SLACK_M as RIM_SLACK_M,
    Estimator as Estimator,
    EstimatorOptions as EstimatorOptions,
)
from .gauss_newton import (
    FAR as FAR,
    MODEL_ERROR as MODEL_ERROR,
    NEAR as NEAR,
    SERVES as SERVES,
    RubberStart as RubberStart,
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
from .plausibility import (
    GAS_NOISE as GAS_NOISE,
    contradicts_gas as contradicts_gas,
    gas_sigma as gas_sigma,
    reason_against_fit as reason_against_fit,
    reason_against_gas as reason_against_gas,
)
from .problem import (
    Equilibrium as Equilibrium,
    FrameProblem as FrameProblem,
    NormalEquations as NormalEquations,
    Pressure as Pressure,
    Scales as Scales,
    natural_residual as natural_residual,
)
from .resolution import (
    detection_threshold as detection_threshold,
    information_density as information_density,
)
from .response import (
    LinearisedRubber as LinearisedRubber,
)
from .rubber_estimator import (
    RubberEstimator as RubberEstimator,
)
from .solvers import (
    ESTIMATORS as ESTIMATORS,
    LINEAR as LINEAR,
    RUBBER as RUBBER,
    SOLVER_NAMES as SOLVER_NAMES,
    SOLVERS as SOLVERS,
    ActiveSetSolver as ActiveSetSolver,
    ReducedHessian as ReducedHessian,
    nonnegative_qp as nonnegative_qp,
    part as part,
)
