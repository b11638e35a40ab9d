# SPDX-License-Identifier: Apache-2.0
"""Integer programs by HiGHS: one thread, fixed seed, a deadline."""

import time
from math import inf

import highspy
import numpy as np

from edgectl.scheduler.integer_program import IntegerProgram, Solution, Solver

# For all programs of one plan together.
DEADLINE_S = 10.0
# Relative to the objective: closer solutions count as equal.
_GAP = 1e-6
_OPTIONS: dict[str, bool | int | float | str] = {
    "output_flag": False,
    "threads": 1,
    "random_seed": 0,
    "mip_rel_gap": _GAP,
    "mip_abs_gap": 1e-7,
    "primal_feasibility_tolerance": 1e-9,
    "mip_feasibility_tolerance": 1e-9,
    # Without these two the programs of 50 edges and 200 tasks take three quarters of the time (ADR 102).
    "mip_heuristic_run_root_reduced_cost": False,
    "mip_heuristic_run_feasibility_jump": False,
}


def make_solver(deadline_s: float = DEADLINE_S) -> Solver:
    """A solver that takes ``deadline_s`` (wall time) for all its programs together."""
    end = time.monotonic() + deadline_s

    def solve(program: IntegerProgram, share: float) -> Solution:
        left = (end - time.monotonic()) * share
        if left <= 0.0:
            return Solution(values=None, bound=inf, timed_out=True)
        return solve_program(program, left)

    return solve


def solve_program(program: IntegerProgram, deadline_s: float) -> Solution:
    """The best solution found, and the bound on all."""
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    for option, value in _OPTIONS.items():
        solver.setOptionValue(option, value)
    solver.setOptionValue("time_limit", deadline_s)
    solver.passModel(_build_model(program))
    if program.start:
        solver.setSolution(
            len(program.start),
            np.fromiter(program.start.keys(), np.int32),
            np.fromiter(program.start.values(), np.float64),
        )
    solver.run()
    status, found = solver.getModelStatus(), solver.getInfo()
    if status == highspy.HighsModelStatus.kInfeasible:
        return Solution(values=None, bound=-inf)
    has_solution = found.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
    values = tuple(solver.getSolution().col_value) if has_solution else None
    is_optimal = status == highspy.HighsModelStatus.kOptimal
    return Solution(
        values=values,
        bound=found.objective_function_value if is_optimal else found.mip_dual_bound,
        timed_out=not is_optimal,
        duals=None if any(program.whole) or not is_optimal else tuple(solver.getSolution().row_dual),
    )


def _build_model(program: IntegerProgram) -> highspy.HighsLp:
    model = highspy.HighsLp()
    count = len(program.gains)
    model.sense_ = highspy.ObjSense.kMaximize
    model.num_col_, model.num_row_ = count, len(program.rows)
    model.col_cost_ = np.array(program.gains)
    model.col_lower_, model.col_upper_ = np.zeros(count), np.array(program.uppers)
    model.row_lower_ = np.array([max(row.lower, -highspy.kHighsInf) for row in program.rows])
    model.row_upper_ = np.array([min(row.upper, highspy.kHighsInf) for row in program.rows])
    model.integrality_ = [
        highspy.HighsVarType.kInteger if whole else highspy.HighsVarType.kContinuous
        for whole in program.whole
    ]
    sizes = [len(row.variables) for row in program.rows]
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = np.concatenate(([0], np.cumsum(sizes, dtype=np.int32))).astype(np.int32)
    model.a_matrix_.index_ = np.array([each for row in program.rows for each in row.variables], np.int32)
    model.a_matrix_.value_ = np.array([each for row in program.rows for each in row.coefficients])
    return model
