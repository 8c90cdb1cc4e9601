"""The numbers that steer a minimisation. Most decide only how fast it ends; `stall` and
`least_fall` decide whether it does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Strategy:
    """How a minimiser proceeds. Residuals are relative to the force scale unless said otherwise."""

    stage_lengths: tuple[int, ...] = (3, 6, 10, 20)
    """Iterations after which rebuilding H0 is considered; the last value repeats."""
    rebuild: int = 8
    """Iterations, or line search evaluations, that cost as much as a new H0."""
    fresh: float = 0.15
    """Reduction of the residual per iteration with a new H0."""
    unsettled: float = 10.0
    """Factor of the squared residual in the stiffness, relative to the taut one, of wrinkled cells
    from the third H0 on: many turn taut, and tangent steps are far too long for that."""
    longest_search: int = 15
    """Evaluations of a line search; longer ones almost always fail."""
    looks: tuple[float, ...] = (1e-5,)
    """Residuals at which `solve` asks whether to go on."""
    looks_of_cables: tuple[float, ...] = (1e-2, 1e-3, 1e-4)
    """The same under cables, whose contacts and paths are judged on the way."""
    stall: int = 50
    """Stages without progress after which a solve ends."""
    least_fall: float = 1e-8
    """Fall of the energy, relative to it, that is progress. Solves of slack membranes have gone 366
    stages without half the residual, in which the energy fell by at least 3e-7 in 100; where it
    fell by less than 1e-9, four of seven failed."""

    far_shift: float = 0.7
    """Shift of a stress-free place, relative to the cell size, at which a solve ends, to go on from
    a mesh that follows; a tenth of it where a line search has failed: cells collapse at about 1."""

    direct: int = 1_000_000
    """Unknowns up to which K is factorised without cables; with cables it always is, as multigrid
    does not resolve the stiff springs that tie cable points to soft fabric. Relative to multigrid a
    load step takes 0.4 to 0.7 of the time on one process; on two 0.9 with 1e5 unknowns, 1.2 with
    1e6."""
    cg_accuracy: float = 1e-2
    """Relative residual of conjugate gradients on H0; a looser one costs BLMVM more iterations."""

    patience: int = 8
    """Stages before Newton's method may take over: cables that pass vertices take a few, which no
    Newton step speeds up."""
    stubborn: float = 0.1
    """Reduction of the residual by a stage above which Newton's method takes over, and by
    `newton_stages` iterations above which it gives up."""
    newton_stages: int = 20
    """Newton iterations within which the residual must fall by the factor `stubborn`."""
    wrinkle_stiffness: float = 1e-2
    """Initial stiffness of wrinkled cells, relative to taut cells times sqrt(residual)."""
    exact: float = 1e-2
    """Residual below which H0 is the second derivatives, without prestress."""
    exact_of_rows: float = 0.2
    """The same where rows slide: other stiffnesses let them slide too far."""
    descent: float = 1e-4
    """Fraction of the predicted descent that a Newton step must achieve (Armijo)."""
    shortest: float = 1e-3
    """The shortest Newton step, relative to the full one."""

    patch_part: float = 0.02
    """Force, relative to the largest, above which a block of a patch is relaxed."""
    patch_rings: int = 3
    """Rings of blocks that are relaxed around it."""
    most_relaxed: float = 0.5
    """Largest fraction of the free blocks in a patch."""
    patched: float = 1e-4
    """Residual above which patches are relaxed."""
    settled: float = 1e-6
    """Residual that a relaxation is to reach."""
    rounds: int = 2
    """Selections of blocks in a relaxation."""
    local_steps: int = 12
    """Newton steps for each selection."""
    largest_patch: int = 200
    """Most blocks in a patch; larger ones are left to the solve."""
    shortest_local: float = 1e-6
    """The shortest Newton step of a patch, relative to the full one."""
    short: float = 0.3
    """Length, relative to Newton's, below which a step by second derivatives is short."""
    twice: int = 2
    """Number of short steps after which H0 replaces these for as many steps."""


STRATEGY = Strategy()
"""That of every solve unless another one is passed."""
