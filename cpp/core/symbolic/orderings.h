#pragma once

/// Orders in which to eliminate the blocks of a symmetric matrix, found on the graph of its blocks.
/// An order holds at k the block that is eliminated as the k-th.

#include <string>
#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

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
