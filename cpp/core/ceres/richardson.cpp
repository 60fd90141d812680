#include "core/ceres/richardson.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace bundle {
namespace {

constexpr int kRows = 8;           ///< of a tableau
constexpr int kTableaux = 5;       ///< before we give up
constexpr double kRestart = 64;    ///< by which the first step of the next tableau is smaller
constexpr double kEnough = 1e-10;  ///< relative error that needs no further step
constexpr double kSafety = 4;      ///< on the estimated error
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// The best entries of all tableaux so far.
class Search {
 public:
  Search(const LineFunction& f, int num_values, const double* noise, double* derivative,
         double* uncertainty)
      : f_(f),
        n_(num_values),
        noise_(noise),
        derivative_(derivative),
        uncertainty_(uncertainty),
        plus_(num_values),
        minus_(num_values),
        table_(static_cast<size_t>(kRows) * num_values),
        next_(static_cast<size_t>(kRows) * num_values) {
    std::fill_n(derivative_, n_, 0.0);
    std::fill_n(uncertainty_, n_, kInfinity);
  }

  /// Fills one tableau from step h on.
  void Run(double h) {
    int row = 0;
    for (int k = 0; k < kRows; ++k, h *= 0.5) {
      if (!CentralDifference(h)) {
        row = 0;  // what was extrapolated from larger steps is worth nothing now
        continue;
      }
      Extrapolate(row, h);
      std::swap(table_, next_);
      ++row;
      if (row >= 3 && Enough(h)) return;
    }
  }

  /// True if nothing is gained by smaller steps than h: errors are small beside the largest
  /// derivative, or are the rounding of the values.
  bool Enough(double h) const {
    double largest = 0;
    for (int i = 0; i < n_; ++i) largest = std::max(largest, std::abs(derivative_[i]));
    for (int i = 0; i < n_; ++i) {
      if (uncertainty_[i] > kEnough * largest + 2 * noise_[i] / h) return false;
    }
    return true;
  }

 private:
  /// Writes D(h) to the head of `next_`.
  bool CentralDifference(double h) {
    if (!f_(h, plus_.data()) || !f_(-h, minus_.data())) return false;
    for (int i = 0; i < n_; ++i) {
      next_[i] = (plus_[i] - minus_[i]) / (2 * h);
      if (!std::isfinite(next_[i])) return false;
    }
    return true;
  }

  void Extrapolate(int row, double h) {
    double power = 1;
    for (int m = 1; m <= row; ++m) {
      power *= 4;
      for (int i = 0; i < n_; ++i) {
        const double left = next_[(m - 1) * n_ + i];
        const double above = table_[(m - 1) * n_ + i];
        const double entry = left + (left - above) / (power - 1);
        next_[m * n_ + i] = entry;
        const double error =
            kSafety * std::max(std::abs(entry - left), std::abs(entry - above)) + noise_[i] / h;
        if (error < uncertainty_[i]) {
          uncertainty_[i] = error;
          derivative_[i] = entry;
        }
      }
    }
  }

  const LineFunction& f_;
  const int n_;
  const double* noise_;
  double* derivative_;
  double* uncertainty_;
  std::vector<double> plus_, minus_;
  std::vector<double> table_, next_;  ///< the last row and the one being made, kRows x num_values
};

}  // namespace

void RichardsonDerivative(const LineFunction& f, int num_values, double first_step,
                          const double* noise, double* derivative, double* uncertainty) {
  Search search(f, num_values, noise, derivative, uncertainty);
  double h = first_step;
  for (int tableau = 0; tableau < kTableaux; ++tableau, h /= kRestart) {
    search.Run(h);
    if (search.Enough(h)) return;
  }
}

}  // namespace bundle
