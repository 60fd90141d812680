#pragma once

/// OpenBLAS: the routines that we call, its threads and its buffers.
///
/// Hidden string lengths are left out of the declarations, as LAPACKE and CBLAS leave them out: no
/// routine reads them.

extern "C" {
/// A = L L^T in place. info > 0: the leading minor of that order is not positive definite.
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
/// b = A^-1 b with the factor of dpotrf_.
void dpotrs_(const char* uplo, const int* n, const int* num_rhs, const double* a, const int* lda,
             double* b, const int* ldb, int* info);
/// The lower or upper triangle of A^-1, in place of the factor of dpotrf_.
void dpotri_(const char* uplo, const int* n, double* a, const int* lda, int* info);
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
/// C = alpha A A^T + beta C, A n x k, of one triangle of C.
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
/// y = alpha A x + beta y, A m x n.
void dgemv_(const char* trans, const int* m, const int* n, const double* alpha, const double* a,
            const int* lda, const double* x, const int* stride_x, const double* beta, double* y,
            const int* stride_y);
}

namespace bundle {

/// OpenBLAS' thread count, which belongs to the whole process: set while this object lives, the
/// caller's own afterwards. OpenBLAS' idle threads spin for a while and take the cores from ours,
/// so only a large factorisation is worth more than one. Those that overlap share the first's
/// count.
class ScopedBlasThreads {
 public:
  explicit ScopedBlasThreads(int num_threads);
  ~ScopedBlasThreads();
  ScopedBlasThreads(const ScopedBlasThreads&) = delete;
  ScopedBlasThreads& operator=(const ScopedBlasThreads&) = delete;
};

/// Makes OpenBLAS take its buffers now, 128 MiB per thread: where it cannot have one it tries for
/// ever. Where there is room for one only, OpenBLAS has one thread from then on. Throws
/// std::bad_alloc. Only where memory is limited: its threads wake up for it and spin, for 30 to
/// 60 ms of CPU time.
void TakeBlasBuffers();

/// Columns of a dense matrix from which on its factorisation is worth OpenBLAS' threads.
inline constexpr int kColumnsWorthBlasThreads = 1000;

}  // namespace bundle
