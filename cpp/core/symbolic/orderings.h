#pragma once

/// Fill-reducing orderings of symmetric block matrices: the orders in which their blocks are
/// eliminated. Entry k of an order is the block that is eliminated as the k-th.

#include <cholmod.h>

#include <string>
#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

/// CHOLMOD's workspace and settings for its orderings, silent: errors are in
/// `common.status`. Its 64-bit functions throughout, as a matrix may have more than 2^31 values.
class CholmodSession {
 public:
  CholmodSession() {
    cholmod_l_start(&common);
    common.print = 0;
    common.try_catch = 1;
    common.error_handler = nullptr;
    // The default moves rows of more than 10 sqrt(n) entries to the end, unordered. In the graph of
    // a photo collection these are most of its rows.
    common.method[0].prune_dense = -1;
  }
  ~CholmodSession() { cholmod_l_finish(&common); }
  CholmodSession(const CholmodSession&) = delete;
  CholmodSession& operator=(const CholmodSession&) = delete;

  cholmod_common common;
};

/// Methods that find an order of the elimination on the graph of the blocks.
enum class OrderingMethod { kNatural, kReverse, kAmd, kColamd, kMetis, kNesdis };

/// Throws InputError if there is no method of that name.
OrderingMethod OrderingFromName(const std::string& name);

/// "natural", "reverse", "amd", "colamd", "metis", "nesdis"
std::string OrderingName(OrderingMethod method);

/// METIS and NESDIS look for small separators, of which a nearly full graph has none; they return
/// AMD's order for one, as CHOLMOD does.
///
/// COLAMD orders the columns of a matrix A such that A^T A stays sparse. It is given an A for which
/// A^T A has the pattern at hand: a row for each edge, with an entry in either vertex' column.
///
/// Empty if the method failed, which only a lack of memory makes it do.
std::vector<int> FindOrder(const BlockPatternView& pattern, OrderingMethod method);

/// True for a graph that METIS and NESDIS are kept from.
bool IsNearlyFull(const BlockPatternView& pattern);

/// Throws InputError unless `order` holds each of 0 ... num_blocks - 1 once.
void CheckOrder(const std::vector<int>& order, int num_blocks);

}  // namespace bundle
