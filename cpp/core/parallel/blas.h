#pragma once

/// OpenBLAS: the routines that are used here, its threads and its buffers.
///
/// The declarations leave out hidden string lengths, like those of LAPACKE and CBLAS: no routine
/// reads them.

extern "C" {
/// A = L L^T in place. info > 0: the leading minor of that order is not positive definite.
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
/// b = A^-1 b with the factor of dpotrf_.
void dpotrs_(const char* uplo, const int* n, const int* num_rhs, const double* a, const int* lda,
             double* b, const int* ldb, int* info);
/// Computes the lower or upper triangle of A^-1, in place of the factor of dpotrf_.
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

/// OpenBLAS' thread count, which applies to the whole process. It is set during the lifetime of
/// this object, and the caller's count is restored afterwards. Idle OpenBLAS threads spin for a
/// while and take the cores from other threads, so only a large factorisation is worth more than
/// one thread. Objects with overlapping lifetimes share the count of the first.
class ScopedBlasThreads {
 public:
  explicit ScopedBlasThreads(int num_threads);
  ~ScopedBlasThreads();
  ScopedBlasThreads(const ScopedBlasThreads&) = delete;
  ScopedBlasThreads& operator=(const ScopedBlasThreads&) = delete;
};

/// Makes OpenBLAS allocate its buffers now, 128 MiB per thread, because it would retry forever if
/// an allocation fails. If memory is too small for all buffers, OpenBLAS uses one thread from then
/// on; throws std::bad_alloc if it is too small for one buffer. Call only if memory is limited: the
/// call wakes all threads of OpenBLAS, which then spin for 30 to 60 ms of CPU time.
void TakeBlasBuffers();

/// Makes the first ScopedBlasThreads call TakeBlasBuffers: most solves call no routine of OpenBLAS.
void TakeBlasBuffersAtFirstUse();

/// From this number of columns on, the factorisation of a dense matrix is worth OpenBLAS' threads.
inline constexpr int kColumnsWorthBlasThreads = 1000;

}  // namespace bundle
