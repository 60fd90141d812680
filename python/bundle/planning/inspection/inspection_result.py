"""What inspecting a problem gives."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.base.display import Display, Displayed
from bundle.base.memory_sizes import format_size
from bundle.base.words import number, plural
from bundle.planning.inspection.peak_memory import Terms

__all__ = ["Inspection", "MethodInspection"]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MethodInspection(Displayed):
    """What one method is predicted to cost.

    Nonzeros of J, of the information matrix and of S count both triangles and the diagonal; those
    of L count its lower triangle with the diagonal.

    Attributes:
        name: "SPARSE_SCHUR amd".
        linear_solver_type: Ceres' name.
        backend: "FUSED", "CERES", or "": neither takes this order, which is here to be compared;
            time and memory are then those of the fused backend.
        ordering: of what is factorised; "" where nothing is.
        preconditioner: Ceres' name, "" for direct solvers.
        num_unknowns: refined numbers.
        nnz_jacobian, nnz_information, nnz_reduced: of J, J^T J and S; S is 0 where it is not made.
        nnz_factor: of L; 0 without a factor, and so the next four.
        fill: pairs of blocks that L has and the matrix has not.
        flops: sum of c^2 + 3 c over the columns of L, c entries below the diagonal.
        cholmod_flops: sum of (c + 1)^2, CHOLMOD's own estimate.
        tree_height: blocks on the longest path of the elimination tree.
        column_count_profile: largest c of up to 200 equal portions of the columns of L, in
            elimination order.
        memory_in_bytes: peak beyond the loaded problem.
        memory_terms: what it is made of, in bytes.
        time_per_step_in_seconds: of a step of the trust region.
        time_terms: what it is made of, in seconds.
        fits_in_memory: whether the machine has that much free, with a tenth to spare.
        is_taken: whether a solve can be made to do this. The fused backend takes the cheapest of
            three orders, whatever the others cost.
        note: what is to be known about the numbers, "" if nothing.
    """

    name: str
    linear_solver_type: str
    backend: str
    ordering: str
    preconditioner: str
    num_unknowns: int
    nnz_jacobian: int
    nnz_information: int
    nnz_reduced: int
    nnz_factor: int
    fill: int
    flops: float
    cholmod_flops: float
    tree_height: int
    column_count_profile: tuple[int, ...]
    memory_in_bytes: float
    memory_terms: Terms
    time_per_step_in_seconds: float
    time_terms: Terms
    fits_in_memory: bool
    is_taken: bool
    note: str

    @property
    def backend_name(self) -> str:
        """The backend as people write it; "-" where neither takes the order."""
        return {"FUSED": "fused", "CERES": "Ceres"}.get(self.backend, "-")

    def _display(self) -> Display:
        facts = [
            ("backend", self.backend_name),
            ("unknowns", str(self.num_unknowns)),
            ("nonzeros of L", number(self.nnz_factor) if self.nnz_factor else "-"),
            ("flops", number(self.flops) if self.flops else "-"),
            ("memory", format_size(self.memory_in_bytes)),
            ("time per step", f"{number(self.time_per_step_in_seconds)} s"),
        ]
        if not self.fits_in_memory:
            facts.append(("", "does not fit into the free memory"))
        if self.note:
            facts.append(("note", self.note))
        return Display(title=f"MethodInspection: {self.name}", facts=tuple(facts))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Inspection(Displayed):
    """What is known of a problem before it is solved.

    Attributes:
        num_observations: those with something to refine.
        num_free_points, num_camera_columns, num_camera_blocks: of the unknowns.
        reduced_density: share of S that is not zero, by nonzeros; 1.0 where no camera
            parameter is refined.
        num_threads: that the times are for.
        available_memory_in_bytes: of the machine, now.
        methods: what each costs.
        recommended: index into methods of the fastest that fits; -1 if none does.
        recommendation: the same in a sentence, with its reason.
        auto_choice: linear solver that the fused backend's ``auto`` takes, which goes by rates of
            its own (cpp/core/prepare/choose_solver.cpp); "" where it does not come into it.
    """

    num_observations: int
    num_free_points: int
    num_camera_columns: int
    num_camera_blocks: int
    reduced_density: float
    num_threads: int
    available_memory_in_bytes: float
    methods: tuple[MethodInspection, ...]
    recommended: int
    recommendation: str
    auto_choice: str

    def _display(self) -> Display:
        unknowns = self.methods[0].num_unknowns if self.methods else 0
        facts = (
            ("problem", plural(self.num_observations, "observation")),
            ("unknowns", f"{unknowns}, those of {plural(self.num_free_points, 'point')} included"),
            ("recommended", self.recommendation),
        )
        rows = tuple(
            (
                f"{'* ' if index == self.recommended else '  '}{method.name}",
                method.backend_name,
                number(method.nnz_factor) if method.nnz_factor else "-",
                number(method.flops) if method.flops else "-",
                format_size(method.memory_in_bytes),
                number(method.time_per_step_in_seconds),
            )
            for index, method in enumerate(self.methods)
        )
        return Display(
            title=f"Inspection: predicted cost on {plural(self.num_threads, 'thread')}",
            facts=facts,
            head=("  method", "backend", "nonzeros of L", "flops", "memory", "s per step"),
            rows=rows,
        )
