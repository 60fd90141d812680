#include "core/sums/communicator.h"

#include <cmath>

namespace bundle {
namespace {

constexpr const char* kScalars = "scalars";
constexpr const char* kSetup = "setup";

/// One number of each rank, rank 0 first.
std::vector<double> OfEach(Reducer* ranks, double value) {
  std::vector<double> values(ranks->num_ranks());
  values[ranks->rank()] = value;
  SumOverRanks(ranks, kScalars, &values);
  return values;
}

}  // namespace

void SumOverRanks(Reducer* ranks, const char* what, std::vector<double>* values) {
  if (ranks == nullptr || values->empty()) return;
  ranks->SumToFirst(what, values->data(), static_cast<int64_t>(values->size()));
  BroadcastFirst(ranks, what, values);
}

void SumOverRanks(Reducer* ranks, std::initializer_list<double*> values) {
  if (ranks == nullptr) return;
  std::vector<double> sums;
  for (const double* value : values) sums.push_back(*value);
  SumOverRanks(ranks, kScalars, &sums);
  auto sum = sums.begin();
  for (double* value : values) *value = *sum++;
}

double SumOverRanks(Reducer* ranks, double value) {
  if (ranks == nullptr) return value;
  std::vector<double> values = {value};
  SumOverRanks(ranks, kScalars, &values);
  return values.front();
}

int64_t SumOverRanks(Reducer* ranks, int64_t value) {
  if (ranks == nullptr) return value;
  return std::llround(SumOverRanks(ranks, static_cast<double>(value)));
}

std::vector<double> RoundOverRanks(Reducer* ranks, const char* what,
                                   const std::vector<TwofoldSum>& values) {
  std::vector<double> sums, rests;
  for (const TwofoldSum& value : values) {
    sums.push_back(value.sum);
    rests.push_back(value.rest);
  }
  if (ranks != nullptr && !values.empty()) {
    ranks->SumTwofoldToFirst(what, sums.data(), rests.data(), static_cast<int64_t>(sums.size()));
  }
  for (size_t i = 0; i < sums.size(); ++i) sums[i] = RoundTwofold(sums[i], rests[i]);
  BroadcastFirst(ranks, what, &sums);
  return sums;
}

void RoundOverRanks(Reducer* ranks, std::initializer_list<TwofoldSum*> values) {
  std::vector<TwofoldSum> sums;
  for (const TwofoldSum* value : values) sums.push_back(*value);
  const std::vector<double> rounded = RoundOverRanks(ranks, kScalars, sums);
  auto sum = rounded.begin();
  for (TwofoldSum* value : values) *value = {*sum++, 0};
}

double RoundOverRanks(Reducer* ranks, const TwofoldSum& value) {
  return RoundOverRanks(ranks, kScalars, {value}).front();
}

double MaxOverRanks(Reducer* ranks, double value) {
  if (ranks == nullptr) return value;
  const std::vector<double> values = OfEach(ranks, value);
  double result = values.front();
  for (const double other : values) {
    if (!(other <= result)) result = other;
    if (std::isnan(result)) break;
  }
  return result;
}

void JoinOverRanks(Reducer* ranks, std::vector<uint8_t>* marks) {
  if (ranks == nullptr) return;
  std::vector<double> sums(marks->begin(), marks->end());
  SumOverRanks(ranks, kSetup, &sums);
  for (size_t i = 0; i < sums.size(); ++i) (*marks)[i] = sums[i] > 0 ? 1 : 0;
}

std::vector<double> ConcatenateOverRanks(Reducer* ranks, const std::vector<double>& values) {
  if (ranks == nullptr) return values;
  const std::vector<double> sizes = OfEach(ranks, static_cast<double>(values.size()));
  std::vector<double> all;
  for (int rank = 0; rank < ranks->num_ranks(); ++rank) {
    std::vector<double> of_rank(static_cast<size_t>(sizes[rank]));
    if (rank == ranks->rank()) of_rank = values;
    if (!of_rank.empty()) {
      ranks->Broadcast(kSetup, of_rank.data(), static_cast<int64_t>(of_rank.size()), rank);
    }
    all.insert(all.end(), of_rank.begin(), of_rank.end());
  }
  return all;
}

std::string FirstOverRanks(Reducer* ranks, const std::string& text) {
  if (ranks == nullptr) return text;
  const std::vector<double> sizes = OfEach(ranks, static_cast<double>(text.size()));
  for (int rank = 0; rank < ranks->num_ranks(); ++rank) {
    if (sizes[rank] == 0) continue;
    std::vector<double> letters(static_cast<size_t>(sizes[rank]));
    if (rank == ranks->rank()) {
      for (size_t i = 0; i < letters.size(); ++i) letters[i] = static_cast<unsigned char>(text[i]);
    }
    ranks->Broadcast(kSetup, letters.data(), static_cast<int64_t>(letters.size()), rank);
    std::string result;
    for (const double letter : letters) result.push_back(static_cast<char>(letter));
    return result;
  }
  return "";
}

void BroadcastFirst(Reducer* ranks, const char* what, std::vector<double>* values) {
  if (ranks == nullptr || values->empty()) return;
  ranks->Broadcast(what, values->data(), static_cast<int64_t>(values->size()), 0);
}

double BroadcastFirst(Reducer* ranks, double value) {
  if (ranks == nullptr) return value;
  std::vector<double> values = {value};
  BroadcastFirst(ranks, kScalars, &values);
  return values.front();
}

}  // namespace bundle
