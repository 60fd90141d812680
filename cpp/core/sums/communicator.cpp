#include "core/sums/communicator.h"

#include <cmath>

namespace bundle {
namespace {

constexpr const char* kScalars = "scalars";
constexpr const char* kSetup = "setup";

/// One number of each rank, rank 0 first.
std::vector<double> OfEach(Communicator* communicator, double value) {
  std::vector<double> values(communicator->num_ranks());
  values[communicator->rank()] = value;
  SumOverRanks(communicator, kScalars, &values);
  return values;
}

}  // namespace

void SumOverRanks(Communicator* communicator, const char* what, std::vector<double>* values) {
  if (communicator == nullptr || values->empty()) return;
  communicator->SumToFirst(what, values->data(), static_cast<int64_t>(values->size()));
  BroadcastFirst(communicator, what, values);
}

void SumOverRanks(Communicator* communicator, std::initializer_list<double*> values) {
  if (communicator == nullptr) return;
  std::vector<double> sums;
  for (const double* value : values) sums.push_back(*value);
  SumOverRanks(communicator, kScalars, &sums);
  auto sum = sums.begin();
  for (double* value : values) *value = *sum++;
}

double SumOverRanks(Communicator* communicator, double value) {
  if (communicator == nullptr) return value;
  std::vector<double> values = {value};
  SumOverRanks(communicator, kScalars, &values);
  return values.front();
}

int64_t SumOverRanks(Communicator* communicator, int64_t value) {
  if (communicator == nullptr) return value;
  return std::llround(SumOverRanks(communicator, static_cast<double>(value)));
}

std::vector<double> RoundOverRanks(Communicator* communicator, const char* what,
                                   const std::vector<DoubleDouble>& values) {
  std::vector<double> sums, errors;
  for (const DoubleDouble& value : values) {
    sums.push_back(value.sum);
    errors.push_back(value.error);
  }
  if (communicator != nullptr && !values.empty()) {
    communicator->SumDoubleDoubleToFirst(what, sums.data(), errors.data(),
                                         static_cast<int64_t>(sums.size()));
  }
  for (size_t i = 0; i < sums.size(); ++i) sums[i] = RoundDoubleDouble(sums[i], errors[i]);
  BroadcastFirst(communicator, what, &sums);
  return sums;
}

void RoundOverRanks(Communicator* communicator, std::initializer_list<DoubleDouble*> values) {
  std::vector<DoubleDouble> sums;
  for (const DoubleDouble* value : values) sums.push_back(*value);
  const std::vector<double> rounded = RoundOverRanks(communicator, kScalars, sums);
  auto sum = rounded.begin();
  for (DoubleDouble* value : values) *value = {*sum++, 0};
}

double RoundOverRanks(Communicator* communicator, const DoubleDouble& value) {
  return RoundOverRanks(communicator, kScalars, {value}).front();
}

double MaxOverRanks(Communicator* communicator, double value) {
  if (communicator == nullptr) return value;
  const std::vector<double> values = OfEach(communicator, value);
  double result = values.front();
  for (const double other : values) {
    if (!(other <= result)) result = other;
    if (std::isnan(result)) break;
  }
  return result;
}

void JoinOverRanks(Communicator* communicator, std::vector<uint8_t>* marks) {
  if (communicator == nullptr) return;
  std::vector<double> sums(marks->begin(), marks->end());
  SumOverRanks(communicator, kSetup, &sums);
  for (size_t i = 0; i < sums.size(); ++i) (*marks)[i] = sums[i] > 0 ? 1 : 0;
}

std::vector<double> ConcatenateOverRanks(Communicator* communicator,
                                         const std::vector<double>& values) {
  if (communicator == nullptr) return values;
  const std::vector<double> sizes = OfEach(communicator, static_cast<double>(values.size()));
  std::vector<double> all;
  for (int rank = 0; rank < communicator->num_ranks(); ++rank) {
    std::vector<double> of_rank(static_cast<size_t>(sizes[rank]));
    if (rank == communicator->rank()) of_rank = values;
    if (!of_rank.empty()) {
      communicator->Broadcast(kSetup, of_rank.data(), static_cast<int64_t>(of_rank.size()), rank);
    }
    all.insert(all.end(), of_rank.begin(), of_rank.end());
  }
  return all;
}

std::string FirstOverRanks(Communicator* communicator, const std::string& text) {
  if (communicator == nullptr) return text;
  const std::vector<double> sizes = OfEach(communicator, static_cast<double>(text.size()));
  for (int rank = 0; rank < communicator->num_ranks(); ++rank) {
    if (sizes[rank] == 0) continue;
    std::vector<double> letters(static_cast<size_t>(sizes[rank]));
    if (rank == communicator->rank()) {
      for (size_t i = 0; i < letters.size(); ++i) letters[i] = static_cast<unsigned char>(text[i]);
    }
    communicator->Broadcast(kSetup, letters.data(), static_cast<int64_t>(letters.size()), rank);
    std::string result;
    for (const double letter : letters) result.push_back(static_cast<char>(letter));
    return result;
  }
  return "";
}

void BroadcastFirst(Communicator* communicator, const char* what, std::vector<double>* values) {
  if (communicator == nullptr || values->empty()) return;
  communicator->Broadcast(what, values->data(), static_cast<int64_t>(values->size()), 0);
}

double BroadcastFirst(Communicator* communicator, double value) {
  if (communicator == nullptr) return value;
  std::vector<double> values = {value};
  BroadcastFirst(communicator, kScalars, &values);
  return values.front();
}

}  // namespace bundle
