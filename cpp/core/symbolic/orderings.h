#pragma once

/// Fill-reducing orderings of symmetric block matrices: orders of elimination of their blocks.
/// Entry k of an order is the block eliminated at step k.

#include <cholmod.h>

#include <string>
#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

/// CHOLMOD's workspace and settings for its orderings, silent: errors are in
/// `common.status`. Only its 64-bit functions are used, because a matrix may have more than 2^31
/// values.
class CholmodSession {
 public:
  CholmodSession() {
    cholmod_l_start(&common);
    common.print = 0;
    common.try_catch = 1;
    common.error_handler = nullptr;
    // The default moves rows of more than 10 sqrt(n) entries to the end, unordered. In the graph of
    // a photo collection, most rows have that many.
    common.method[0].prune_dense = -1;
  }
  ~CholmodSession() { cholmod_l_finish(&common); }
  CholmodSession(const CholmodSession&) = delete;
  CholmodSession& operator=(const CholmodSession&) = delete;

  cholmod_common common;
};

/// Methods that compute an elimination order from the graph of the blocks.
enum class OrderingMethod { kNatural, kReverse, kAmd, kColamd, kMetis, kNesdis, kMinimumFill };

/// Throws InputError if no method has that name.
OrderingMethod OrderingFromName(const std::string& name);

/// "natural", "reverse", "amd", "colamd", "metis", "nesdis", "minimum_fill"
std::string OrderingName(OrderingMethod method);

/// METIS and NESDIS search for small separators, which a nearly full graph does not have. For such
/// a graph they return AMD's order, as CHOLMOD does.
///
/// COLAMD orders the columns of a matrix A such that A^T A stays sparse. Its input is an A for
/// which A^T A has the given pattern: a row for each edge, with entries in the columns of its two
/// vertices.
///
/// Minimum fill eliminates a block that adds the fewest blocks of fill-in, then one with the fewest
/// neighbours, then the first. AMD bounds degrees instead. On graphs of many overlapping cliques,
/// minimum fill saves a tenth to a quarter of AMD's flops. For a graph on which it would take
/// longer than milliseconds it returns AMD's order.
///
/// Empty if the method failed, which happens only if memory is short.
std::vector<int> FindOrder(const BlockPatternView& pattern, OrderingMethod method);

/// True for a nearly full graph, for which METIS and NESDIS are not called.
bool IsNearlyFull(const BlockPatternView& pattern);

/// True if minimum fill takes milliseconds at most.
bool IsFastByFill(const BlockPatternView& pattern);

/// Throws InputError unless `order` holds each of 0 ... num_blocks - 1 once.
void CheckOrder(const std::vector<int>& order, int num_blocks);

}  // namespace bundle
