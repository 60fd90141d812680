#pragma once

#include "core/parallel/thread_pool.h"

namespace bundle {

/// A = L L^T in place, of the lower triangle of an n x n column-major matrix, on all threads.
///
/// OpenBLAS' own threads divide a factorisation by their number, and its last digits depend on it.
/// So A is cut into tiles here, whatever the threads. Tile column after tile column, right-looking,
/// with a triangular solve or a matrix product per tile, each by one thread:
///
///   A_kk = L_kk L_kk^T,    L_ik = A_ik L_kk^-T,    A_ij -= L_ik L_jk^T    for i >= j > k.
///
/// Tiles of one kind are independent and dealt out as threads become free; each is the same sum in
/// the same order, so that no bit depends on how many there are. (A. Buttari, J. Langou, J. Kurzak,
/// J. Dongarra: A class of parallel tiled linear algebra algorithms for multicore architectures,
/// Parallel Computing 35, 2009, without its graph of tasks.) It takes a tenth longer than OpenBLAS
/// with two threads, for 9,000 columns.
///
/// Returns 0, or the order of a leading minor that is not positive definite; A then means nothing.
/// OpenBLAS has to have one thread meanwhile.
int FactorizeTiled(double* a, int n, ThreadPool* pool);

}  // namespace bundle
