#pragma once

/// The two routines of LAPACK that a dense reduced system needs, as OpenBLAS exports them. Hidden
/// string lengths are left out, as LAPACKE leaves them out: neither routine reads them.

extern "C" {
/// A = L L^T in place. info > 0: the leading minor of that order is not positive definite.
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
/// b = A^-1 b with the factor of dpotrf_.
void dpotrs_(const char* uplo, const int* n, const int* num_rhs, const double* a, const int* lda,
             double* b, const int* ldb, int* info);
}
