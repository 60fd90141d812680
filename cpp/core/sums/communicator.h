#pragma once

/// Communication of the ranks that solve one problem together.
///
/// A *rank* is a process. It holds a part of the points with their observations, and all camera
/// parameters. All ranks run the same code and call the functions below in the same order. A sum
/// over points is a sum on each rank, then a sum over ranks. Rank 0 adds and broadcasts the result,
/// so that all ranks continue with the same bits. A decision that depends on anything else (the
/// clock, free memory, the user) is made by rank 0 and broadcast.
///
/// The core does not depend on MPI: a binding implements Communicator with any message library. If
/// one rank throws between two calls, the others wait for it; the caller has to end them.
///
/// All functions accept nullptr for a problem that is not divided among ranks, and then do not
/// change the values.

#include <cstdint>
#include <initializer_list>
#include <string>
#include <vector>

#include "core/sums/double_double.h"

namespace bundle {

/// Sums and broadcasts among ranks. `what` is the name of the quantity, for reports.
class Communicator {
 public:
  virtual ~Communicator() = default;
  virtual int rank() const = 0;
  virtual int num_ranks() const = 0;
  /// Sums over ranks to rank 0, in the same order in every run. On other ranks the values are
  /// undefined afterwards.
  virtual void SumToFirst(const char* what, double* values, int64_t count) = 0;
  /// Same as SumToFirst for double-doubles, given as sums and their error terms.
  virtual void SumDoubleDoubleToFirst(const char* what, double* sums, double* errors,
                                      int64_t count) = 0;
  /// Sends the values of rank `root` to all ranks.
  virtual void Broadcast(const char* what, double* values, int64_t count, int root) = 0;
};

inline bool IsFirst(const Communicator* communicator) {
  return communicator == nullptr || communicator->rank() == 0;
}

/// Sums over ranks, on all ranks.
void SumOverRanks(Communicator* communicator, const char* what, std::vector<double>* values);
/// Sums of a few numbers, in one message.
void SumOverRanks(Communicator* communicator, std::initializer_list<double*> values);
double SumOverRanks(Communicator* communicator, double value);
int64_t SumOverRanks(Communicator* communicator, int64_t value);
/// Sums of double-doubles over ranks, rounded to doubles, on all ranks.
std::vector<double> RoundOverRanks(Communicator* communicator, const char* what,
                                   const std::vector<DoubleDouble>& values);
/// RoundOverRanks of a few numbers, in one message and in place.
void RoundOverRanks(Communicator* communicator, std::initializer_list<DoubleDouble*> values);
double RoundOverRanks(Communicator* communicator, const DoubleDouble& value);

/// Maximum over ranks; NaN if any value is NaN.
double MaxOverRanks(Communicator* communicator, double value);

/// Logical or over ranks: a mark becomes 1 if it is not 0 on some rank.
void JoinOverRanks(Communicator* communicator, std::vector<uint8_t>* marks);

/// Values of all ranks in one vector, those of rank 0 first.
std::vector<double> ConcatenateOverRanks(Communicator* communicator,
                                         const std::vector<double>& values);

/// First nonempty text, in the order of ranks; "" if all are empty.
std::string FirstOverRanks(Communicator* communicator, const std::string& text);

/// Broadcasts from rank 0.
void BroadcastFirst(Communicator* communicator, const char* what, std::vector<double>* values);
double BroadcastFirst(Communicator* communicator, double value);

}  // namespace bundle
