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
/// the same order, so that no bit depends on the number of threads. (A. Buttari, J. Langou, J.
/// Kurzak, J. Dongarra: A class of parallel tiled linear algebra algorithms for multicore
/// architectures, Parallel Computing 35, 2009, without its graph of tasks.) With two threads and
/// 9,000 columns, it takes a tenth longer than OpenBLAS.
///
/// Small systems have small tiles, because two threads need several tiles to share. With 568
/// columns and two threads, a factorisation then takes half of the time of one thread.
///
/// Returns 0, or the order of a leading minor that is not positive definite; A is then undefined.
/// OpenBLAS must use one thread during the call.
inline constexpr int kColumnsWorthTiles = 192, kColumnsOfSmallTiles = 2000;
int FactorizeTiled(double* a, int n, ThreadPool* pool);

}  // namespace bundle
