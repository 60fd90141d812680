from __future__ import annotations

import pytest
from benchmarks.runners import ceres_log

# Lines as Ceres 2.1 prints them, with a rejected step; columns beyond the first two are not ours.
PRINTED = """\
iter      cost      cost_change  |gradient|   |step|    tr_ratio  tr_radius  ls_iter  iter_time  \
total_time
   0  4.185660e+06    0.00e+00    2.16e+07   0.00e+00   0.00e+00  1.00e+04        0    5.32e-02    \
1.45e-01
   1  9.980525e+07   -3.99e+06    5.34e+06   2.40e+03  -9.60e-01  3.00e+04        1    1.22e-01    \
2.67e-01
   2  1.803391e+04    4.66e+00    3.11e+02   1.02e+01   1.00e+00  1.11e+06        1    7.76e-02    \
6.36e-01

Solver Summary (v 2.1.0-eigen-(3.4.0)-lapack-suitesparse-(5.12.0)-eigensparse-no_openmp)

                                     Original                  Reduced
Parameter blocks                        22122                    22122

Minimizer                        TRUST_REGION

                                        Given                     Used
Linear solver                     DENSE_SCHUR             SPARSE_SCHUR
Threads                                     2                        2
Linear solver ordering               22106,16                 22106,16
Schur structure                         2,3,d                    2,3,9

Cost:
Initial                          4.185660e+06
Final                            1.803391e+04
Change                           4.167626e+06

Minimizer iterations                        3
Successful steps                            2
Unsuccessful steps                          1

Time (in seconds):
Preprocessor                         0.091460

  Residual only evaluation           0.066211 (6)
  Jacobian & residual evaluation     0.214615 (5)
  Linear solver                      0.239472 (7)
Minimizer                            0.593452

Postprocessor                        0.002870
Total                                0.687784

Termination:                      CONVERGENCE (Function tolerance reached.)
"""


def test_the_table_of_iterations():
    trace = ceres_log.iterations(PRINTED, 1.80339053e4)
    assert [seconds for seconds, _ in trace] == [0.145, 0.267, 0.636]
    assert [cost for _, cost in trace] == pytest.approx(
        [4.1856595e6, 9.9805245e7, 1.80339053e4], rel=1e-12
    )


def test_a_cost_is_never_below_the_final_one_nor_above_what_was_printed():
    lowest = ceres_log.iterations(PRINTED, 0.0)[-1][1]
    assert lowest == pytest.approx(1.8033905e4, rel=1e-12)
    assert f"{1.0000001 * lowest:.6e}" == "1.803391e+04"


def test_the_full_report():
    report = ceres_log.report(PRINTED)
    assert report == ceres_log.Report(
        linear_solver="SPARSE_SCHUR",
        schur_structure="2,3,9",
        initial_cost=4.185660e6,
        final_cost=1.803391e4,
        num_linear_solves=7,
        minimizer_time=0.593452,
        total_time=0.687784,
        termination="CONVERGENCE",
        ceres="2.1.0",
    )


@pytest.mark.parametrize("line", ["Minimizer     ", "Total  ", "Termination", "Schur structure"])
def test_a_report_without_a_line_names_it(line):
    lines = [text for text in PRINTED.splitlines() if not text.startswith(line)]
    with pytest.raises(ValueError, match=line.split()[0]):
        ceres_log.report("\n".join(lines))
