#pragma once

#include "core/parallel/thread_pool.h"

namespace bundle {

/// A = L L^T in place, from the lower triangle of an n x n column-major matrix, on all threads.
///
/// OpenBLAS divides a factorisation by the number of its threads, and the last digits depend on it.
/// Here, A is divided into tiles that do not depend on the threads. Tile columns are processed in
/// order, right-looking. Each tile takes a triangular solve or a matrix product by one thread:
///
///   A_kk = L_kk L_kk^T,    L_ik = A_ik L_kk^-T,    A_ij -= L_ik L_jk^T    for i >= j > k.
///
/// Tiles of one kind are independent and assigned to threads dynamically. Each is the same sum in
/// the same order, so that the bits do not depend on the number of threads. (A. Buttari, J. Langou,
/// J. Kurzak, J. Dongarra: A class of parallel tiled linear algebra algorithms for multicore
/// architectures, Parallel Computing 35, 2009, without its graph of tasks.) With two threads and
/// 9,000 columns, it takes a tenth longer than OpenBLAS.
///
/// With AVX-512, and with AVX2 below 2,000 columns, the kernels of supernodal panels take the place
/// of BLAS. OpenBLAS copies tiles into packed buffers, which it touches for the first time in its
/// first call, and may not use AVX-512 (Debian 12's does not on processors of AMD): from 100 to
/// 7,000 columns it takes twice as long, and ten times in the first call with 200. Below
/// kColumnsWorthTiles one thread is as fast as two.
///
/// Returns 0, or the order of a leading minor that is not positive definite; A is then undefined,
/// as entries above the diagonal always are. OpenBLAS must use one thread during the call. `pool`:
/// nullptr: on this thread.
inline constexpr int kColumnsWorthTiles = 500;
int FactorizeTiled(double* a, int n, ThreadPool* pool);

/// True if FactorizeTiled uses our kernels.
bool HasOwnKernels(int n);

/// x = L^-T L^-1 x
void SolveTiled(const double* l, int n, double* x);

}  // namespace bundle
