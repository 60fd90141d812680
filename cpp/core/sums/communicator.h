#pragma once

/// Many processes at one problem.
///
/// Each process, a *rank*, holds some of the points with their observations and all of the camera
/// parameters. All ranks run the same code on them and meet in a Reducer, in the same order: a sum
/// over points becomes a sum over ranks, and everything that follows from it is the same on each of
/// them, bit for bit, because rank 0 sums and then sends what it has. A decision that depends on
/// anything else (a clock, free memory, the user) is rank 0's and is broadcast.
///
/// The core knows no MPI: a binding implements this interface by whatever sends messages. A rank
/// that throws between two meetings leaves the others waiting; the caller has to end them.
///
/// The functions below take nullptr for a problem that is not divided, and then do nothing.

#include <cstdint>
#include <initializer_list>
#include <string>
#include <vector>

#include "core/sums/double_double.h"

namespace bundle {

class Reducer {
 public:
  virtual ~Reducer() = default;
  virtual int rank() const = 0;
  virtual int num_ranks() const = 0;
  /// Rank 0 gets the sums over all ranks, in the same order in every run; elsewhere the values mean
  /// nothing afterwards. `what` is the quantity, for reports.
  virtual void SumToFirst(const char* what, double* values, int64_t count) = 0;
  /// The same of twofold sums (twofold_sum.h): rank 0 gets those of all ranks.
  virtual void SumTwofoldToFirst(const char* what, double* sums, double* rests, int64_t count) = 0;
  /// All ranks get the values of rank `root`.
  virtual void Broadcast(const char* what, double* values, int64_t count, int root) = 0;
};

inline bool IsFirst(const Reducer* ranks) { return ranks == nullptr || ranks->rank() == 0; }

/// Values become their sums, on all ranks.
void SumOverRanks(Reducer* ranks, const char* what, std::vector<double>* values);
/// The same of a few numbers, in one message.
void SumOverRanks(Reducer* ranks, std::initializer_list<double*> values);
double SumOverRanks(Reducer* ranks, double value);
int64_t SumOverRanks(Reducer* ranks, int64_t value);
/// Twofold sums over all ranks, rounded, on all of them.
std::vector<double> RoundOverRanks(Reducer* ranks, const char* what,
                                   const std::vector<TwofoldSum>& values);
/// The same of a few numbers, in one message, each in place of its sum.
void RoundOverRanks(Reducer* ranks, std::initializer_list<TwofoldSum*> values);
double RoundOverRanks(Reducer* ranks, const TwofoldSum& value);

/// The largest; one that is not a number, if there is any.
double MaxOverRanks(Reducer* ranks, double value);

/// Marks (0 or not) become 1 where any rank has one.
void JoinOverRanks(Reducer* ranks, std::vector<uint8_t>* marks);

/// The values of all ranks, rank 0 first.
std::vector<double> ConcatenateOverRanks(Reducer* ranks, const std::vector<double>& values);

/// The text of the first rank that has one, "" if there is none.
std::string FirstOverRanks(Reducer* ranks, const std::string& text);

/// That of rank 0.
void BroadcastFirst(Reducer* ranks, const char* what, std::vector<double>* values);
double BroadcastFirst(Reducer* ranks, double value);

}  // namespace bundle
