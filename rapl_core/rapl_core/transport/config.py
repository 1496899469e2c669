"""How a transport problem is posed and what its solution reports. Needs no torch by itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from rapl_core.errors import ShapeError, UnknownNameError

if TYPE_CHECKING:
    import torch

CostKind = Literal["cosine", "euclidean", "sqeuclidean"]
SolverKind = Literal["sinkhorn", "exact", "uniform"]
ExpertChoice = Literal["closest", "mean"]


@dataclass(frozen=True)
class TransportConfig:
    """A transport problem between two videos, and how a reward is made of it.

    ``sinkhorn`` is the entropic problem of the paper (App. A, eq. app_ot_problem_regu), ``exact``
    its limit for epsilon = 0, ``uniform`` its limit for epsilon = infinity (every frame coupled to
    every frame alike, a cost that is a mean over all pairs).
    """

    cost: CostKind = "cosine"
    solver: SolverKind = "sinkhorn"
    epsilon: float = 0.05
    """Weight of the entropy, in the unit of the cost; sinkhorn only."""
    max_iterations: int = 2000
    """Sinkhorn only; counted in tens."""
    tolerance: float = 1e-6
    """Sinkhorn stops when the L1 error of the marginals, whose mass is 1, is below it."""
    expert: ExpertChoice = "closest"
    """``closest``: the expert with the least cost (eq. select_expert_obs). ``mean``: all experts,
    weighted by their length; with ``uniform`` the mean over all experts' frames."""
    require_convergence: bool = False
    """Raise ConvergenceError instead of reporting that the solver did not converge."""

    def __post_init__(self) -> None:
        for kind, name, known in (
            ("transport cost", self.cost, get_args(CostKind)),
            ("transport solver", self.solver, get_args(SolverKind)),
            ("expert choice", self.expert, get_args(ExpertChoice)),
        ):
            if name not in known:
                raise UnknownNameError(kind, name, known)
        for field in ("epsilon", "tolerance"):
            number = getattr(self, field)
            if not (math.isfinite(number) and number > 0):
                raise ShapeError(f"TransportConfig.{field} is {number}, expected a number above 0")
        if self.max_iterations < 1:
            raise ShapeError(
                f"TransportConfig.max_iterations is {self.max_iterations}, expected at least 1"
            )


@dataclass(frozen=True)
class TransportResult:
    """A coupling and how it was found. Leading dimensions (...) are those of the cost matrix."""

    plan: torch.Tensor
    """(..., T, S) mass moved from frame t to frame s; rows sum to 1/T, columns to 1/S."""
    cost: torch.Tensor
    """(...) sum of plan times cost matrix, without the entropy."""
    converged: torch.Tensor
    """(...) bool."""
    iterations: torch.Tensor
    """(...) int64 Sinkhorn iterations; 0 for the other solvers, which do not count."""
    marginal_error: torch.Tensor
    """(...) L1 distance of the plan's marginals from the uniform ones."""
