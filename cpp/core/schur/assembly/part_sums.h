#pragma once

/// Sums by parts that are mapped to the layout once per pass, after the last chunk.
///
/// With hard-tied twists, the columns of an image move with the poses before and after it. A block
/// of two images is then mapped to nine blocks of S (schur/column_map.h). Each chunk that has the
/// block would map it again. The maps are linear and depend only on the state:
///
///   S = M^T S_parts M,    g = M^T g_parts,    S_parts = sum over the chunks.
///
/// So chunks are added to S_parts, whose structure has a block per part and one per pair of parts
/// in a chunk, and S_parts is mapped at the end. Every block column of S is written by one thread,
/// from the blocks of S_parts in their order: the bits do not depend on the number of threads.

#include <cstdint>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"

namespace bundle {

class PartSums {
 public:
  /// Keeps references to the arguments but the plan. `to_layout`: assembler of S, with structure
  /// `structure`.
  PartSums(const AdjustmentProblem& problem, const ParameterLayout& layout, const ImageParts& parts,
           const Kernels& kernels, const EliminationPlan& plan, const BlockStructure& structure,
           const Assembler& to_layout, bool has_error_terms);
  PartSums(const PartSums&) = delete;
  PartSums& operator=(const PartSums&) = delete;

  const BlockStructure& structure() const { return structure_; }
  const Assembler& assembler() const { return assembler_; }

  /// Writes the mapped sums. `from` has a camera_diagonal and no error terms that count.
  void Map(const CameraSums& from, bool wants_camera_diagonal, ThreadPool* pool,
           CameraSums* to) const;

 private:
  /// A block of S_parts, and the blocks of its parts that it is mapped to.
  struct Term {
    int first, second;  ///< parts
    int8_t s, t;        ///< indices in Assembler::blocks_of
    int64_t entry;      ///< in structure_
  };
  template <typename Visit>
  void ForTerms(const Visit& visit) const;
  void MapTerm(const BlockValues& values, const Term& term, CameraSums* to) const;
  void MapVectors(const CameraSums& from, CameraSums* to) const;

  const ImageParts& parts_;
  const BlockStructure& of_layout_;
  const Assembler& to_layout_;
  const BlockStructure structure_;
  Assembler assembler_;
  std::vector<int64_t> term_begin_;  ///< first term of each block column of S, and the end
  std::vector<Term> terms_;
};

}  // namespace bundle
