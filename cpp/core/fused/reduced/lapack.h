#pragma once

/// The routines of BLAS and LAPACK that reduced systems need, as OpenBLAS exports them. Hidden
/// string lengths are left out, as LAPACKE and CBLAS leave them out: no routine reads them.

extern "C" {
/// A = L L^T in place. info > 0: the leading minor of that order is not positive definite.
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
/// b = A^-1 b with the factor of dpotrf_.
void dpotrs_(const char* uplo, const int* n, const int* num_rhs, const double* a, const int* lda,
             double* b, const int* ldb, int* info);
/// B = alpha T^-1 B, or with T on the right, T triangular.
void dtrsm_(const char* side, const char* uplo, const char* trans, const char* diag, const int* m,
            const int* n, const double* alpha, const double* t, const int* ldt, double* b,
            const int* ldb);
/// x = T^-1 x, T triangular.
void dtrsv_(const char* uplo, const char* trans, const char* diag, const int* n, const double* t,
            const int* ldt, double* x, const int* stride);
/// C = alpha A B + beta C, A m x k.
void dgemm_(const char* trans_a, const char* trans_b, const int* m, const int* n, const int* k,
            const double* alpha, const double* a, const int* lda, const double* b, const int* ldb,
            const double* beta, double* c, const int* ldc);
/// y = alpha A x + beta y, A m x n.
void dgemv_(const char* trans, const int* m, const int* n, const double* alpha, const double* a,
            const int* lda, const double* x, const int* stride_x, const double* beta, double* y,
            const int* stride_y);
}
