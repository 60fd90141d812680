#pragma once

/// Verdict on Jacobians at several points, with the mistakes in words: the part of bundle/check.h
/// that does not need Ceres.

#include <bundle/check_types.h>
#include <bundle/entry_scales.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <ostream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace bundle {

/// Result of a check.
class GradientCheck {
 public:
  GradientCheck(std::vector<CheckedBlock> blocks, std::vector<CheckedPoint> points,
                int num_residuals, double tolerance, int num_skipped)
      : blocks_(std::move(blocks)),
        points_(std::move(points)),
        rows_(num_residuals),
        tolerance_(tolerance),
        num_skipped_(num_skipped) {
    for (const CheckedBlock& block : blocks_) columns_ += block.size;
    scale_ = EntryScales(points_, rows_, columns_, tolerance_).values();
    Judge();
  }

  bool ok() const { return verdict_ == "correct"; }
  explicit operator bool() const { return ok(); }

  /// "correct", "wrong" or "undecided".
  const std::string& verdict() const { return verdict_; }
  const std::vector<GradientFinding>& findings() const { return findings_; }
  /// The wrong entry with the largest error of each column, the worst first.
  const std::vector<GradientEntry>& worst() const { return worst_; }
  double tolerance() const { return tolerance_; }
  int num_checked() const { return static_cast<int>(points_.size()); }
  int num_skipped() const { return num_skipped_; }

  /// Name of a column, such as "camera [1]".
  std::string ColumnName(int column) const {
    size_t b = 0;
    while (column >= blocks_[b].size) column -= blocks_[b++].size;
    if (blocks_[b].size == 1) return blocks_[b].name;
    const std::string number = std::to_string(column);
    return blocks_[b].name + (blocks_[b].is_curved ? " direction " + number : " [" + number + "]");
  }

  std::string ToString() const {
    std::ostringstream out;
    const std::string samples = Count(num_checked(), "sample");
    if (ok()) {
      out << "Correct: all Jacobians agree with the reference to " << tolerance_ << " at "
          << samples << ".";
    } else if (verdict_ == "undecided") {
      out << "UNDECIDED: no mistake found, but the accuracy of the reference is not sufficient.";
    } else {
      out << "WRONG: " << Count(static_cast<int>(findings_.size()), "finding")
          << ", the worst first.";
    }
    for (const GradientFinding& finding : findings_) out << "\n- " << finding.sentence;
    for (const GradientEntry& entry : worst_) {
      out << "\n"
          << ColumnName(entry.column) << ", sample " << entry.sample << ", row " << entry.residual
          << ": " << entry.analytic << ", should be " << entry.reference << " (error "
          << Short("%.1e", entry.error) << ")";
    }
    return out.str();
  }

 private:
  static std::string Count(int count, const std::string& noun) {
    return std::to_string(count) + " " + noun + (count == 1 ? "" : "s");
  }

  static std::string Short(const char* format, double value) {
    char text[64];
    std::snprintf(text, sizeof(text), format, value);
    return text;
  }

  size_t At(int row, int column) const { return static_cast<size_t>(row) * columns_ + column; }
  double scale(size_t k, int row, int column) const {
    return scale_[k * rows_ * columns_ + At(row, column)];
  }

  double Error(size_t k, int row, int column) const {
    const CheckedPoint& point = points_[k];
    const double analytic = point.analytic[At(row, column)];
    if (!std::isfinite(analytic)) return HUGE_VAL;
    const double doubt = point.uncertainty[At(row, column)];
    if (!std::isfinite(doubt)) return 0;
    const double off = std::abs(analytic - point.reference[At(row, column)]);
    return std::max(off - doubt, 0.0) / scale(k, row, column);
  }

  void Judge() {
    std::vector<int> wrong;
    int first = 0;
    for (const CheckedBlock& block : blocks_) {
      int num_unknown = 0;
      for (int j = first; j < first + block.size; ++j) {
        if (LookForMistakes(j)) wrong.push_back(j);
        num_unknown += IsUnknown(j) ? 1 : 0;
      }
      if (2 * num_unknown > block.size) {
        findings_.push_back({"undecided",
                             block.name + ": the residual is too noisy or too rough there for any "
                                          "reference; nothing can be said",
                             {}});
      }
      first += block.size;
    }
    std::sort(worst_.begin(), worst_.end(),
              [](const GradientEntry& a, const GradientEntry& b) { return a.error > b.error; });
    if (wrong.empty()) LookForKinks();
    const bool is_undecided = points_.empty() || !findings_.empty();
    verdict_ = !wrong.empty() ? "wrong" : is_undecided ? "undecided" : "correct";
    if (!wrong.empty()) Name(wrong);
  }

  /// Adds a finding if the given point is on a kink or a jump.
  void LookForKinks() {
    constexpr double kRough = 1e-3;
    if (points_.empty() || points_[0].number != 0) return;
    std::vector<int> rough;
    for (int j = 0; j < columns_; ++j) {
      bool is_rough = false;
      for (int i = 0; i < rows_; ++i) {
        double size = scale(0, i, j);
        for (int c = 0; c < columns_; ++c) {
          size = std::max(size, std::abs(points_[0].reference[At(i, c)]));
        }
        is_rough |= !(points_[0].uncertainty[At(i, j)] <= kRough * size);
      }
      if (is_rough) rough.push_back(j);
    }
    if (rough.empty()) return;
    findings_.push_back({"undecided",
                         Names(rough) +
                             ": the given point is on a kink, a jump or the border of the "
                             "residual's domain: the derivative there is undecided",
                         {}});
  }

  bool LookForMistakes(int column) {
    GradientEntry worst;
    for (size_t k = 0; k < points_.size(); ++k) {
      for (int i = 0; i < rows_; ++i) {
        const double error = Error(k, i, column);
        if (error <= tolerance_ || error <= worst.error) continue;
        worst = {points_[k].number,
                 i,
                 column,
                 points_[k].analytic[At(i, column)],
                 points_[k].reference[At(i, column)],
                 error};
      }
    }
    if (worst.error > 0) worst_.push_back(worst);
    return worst.error > 0;
  }

  /// True if most entries have no accurate reference; certain zeros do not count.
  bool IsUnknown(int column) const {
    int unknown = 0, telling = 0;
    for (size_t k = 0; k < points_.size(); ++k) {
      for (int i = 0; i < rows_; ++i) {
        const double doubt = points_[k].uncertainty[At(i, column)];
        const bool is_unknown =
            !(doubt <= tolerance_ * scale(k, i, column)) && Error(k, i, column) <= tolerance_;
        unknown += is_unknown ? 1 : 0;
        telling += is_unknown || std::abs(points_[k].reference[At(i, column)]) > doubt ? 1 : 0;
      }
    }
    return 2 * unknown > telling;
  }

  /// The constant analytic / reference of a column, if there is one; otherwise not a number.
  double Factor(int column) const {
    double product = 0, square = 0;
    ForEach(column, [&](double given, double right) {
      product += given * right;
      square += right * right;
    });
    if (square == 0) return NAN;
    const double factor = product / square;
    double left = 0, off = 0;
    ForEach(column, [&](double given, double right) {
      left += (given - factor * right) * (given - factor * right);
      off += (given - right) * (given - right);
    });
    constexpr double kExplained = 1e-5;
    return left <= kExplained * kExplained * off ? factor : NAN;
  }

  /// Calls f(analytic, reference), both in units of the scale, at all points that have both.
  template <typename F>
  void ForEach(int column, const F& f) const {
    for (size_t k = 0; k < points_.size(); ++k) {
      for (int i = 0; i < rows_; ++i) {
        if (!std::isfinite(points_[k].uncertainty[At(i, column)])) continue;
        f(points_[k].analytic[At(i, column)] / scale(k, i, column),
          points_[k].reference[At(i, column)] / scale(k, i, column));
      }
    }
  }

  /// Adds a finding for each kind of mistake, in the words of bundle.check_gradients.
  void Name(const std::vector<int>& wrong) {
    for (const int j : wrong) {
      const std::pair<std::string, std::string> found = Describe(j);
      const auto same = std::find_if(findings_.begin(), findings_.end(), [&](const auto& finding) {
        return finding.kind == found.first && finding.sentence == found.second;
      });
      if (same != findings_.end()) {
        same->columns.push_back(j);
      } else {
        findings_.push_back({found.first, found.second, {j}});
      }
    }
    for (GradientFinding& finding : findings_) {
      if (finding.columns.empty()) continue;
      finding.sentence = Names(finding.columns) + ": " + finding.sentence;
    }
  }

  std::string Names(const std::vector<int>& columns) const {
    std::string names;
    for (size_t n = 0; n < columns.size(); ++n) {
      const char* const before = n == 0 ? "" : n + 1 == columns.size() ? " and " : ", ";
      const std::string name = ColumnName(columns[n]), head = name.substr(0, name.rfind(' ') + 1);
      const bool is_same = n > 0 && ColumnName(columns[n - 1]).compare(0, head.size(), head) == 0;
      names += before + (is_same ? name.substr(head.size()) : name);
    }
    return names;
  }

  std::pair<std::string, std::string> Describe(int column) const {
    bool is_finite = true, is_zero = true;
    double largest = 0;
    ForEach(column, [&](double given, double right) {
      is_finite &= std::isfinite(given);
      is_zero &= given == 0;
      largest = std::max(largest, std::abs(given - right));
    });
    if (!is_finite) return {"not_finite", "not a finite number"};
    if (is_zero) {
      return {"zero", "zero, although the residual depends on it; the derivative is missing"};
    }
    const double factor = Factor(column);
    if (std::isfinite(factor)) return DescribeFactor(factor);
    if (largest <= 1e-4 && !IsSpread(column)) {
      return {"small_part", "wrong in the last digits of residual " + WrongRows(column) +
                                " only: a small term, or a constant with few digits"};
    }
    if (largest <= 1e-4) {
      return {"float_precision",
              "the last digits are wrong without a pattern: computed in float precision, or by "
              "differences"};
    }
    if (largest < 0.3) {
      return {"small_part",
              "wrong in a small part: a sign or a term of the chain rule is missing there"};
    }
    return {"large_part",
            "wrong as a whole: the order of variables, a transpose, or another formula"};
  }

  /// True if most entries of a column, or of all columns if it has one, are off at its wrong
  /// points.
  bool IsSpread(int column) const {
    std::vector<int> known(columns_, 0), off(columns_, 0);
    int num_rows = 0;
    for (int i = 0; i < rows_; ++i) {
      bool has_any = false;
      for (size_t k = 0; k < points_.size(); ++k) {
        double worst = 0;
        for (int r = 0; r < rows_; ++r) worst = std::max(worst, Error(k, r, column));
        if (!(worst > tolerance_)) continue;
        for (int j = 0; j < columns_; ++j) {
          const double doubt = points_[k].uncertainty[At(i, j)] / scale(k, i, j);
          if (points_[k].reference[At(i, j)] == 0 || !(doubt <= 0.1)) continue;
          ++known[j];
          off[j] += Error(k, i, j) > 0 ? 1 : 0;
          has_any |= j == column;
        }
      }
      num_rows += has_any ? 1 : 0;
    }
    if (num_rows > 1) return 2 * off[column] > known[column];
    return 2 * std::accumulate(off.begin(), off.end(), 0) >
           std::accumulate(known.begin(), known.end(), 0);
  }

  std::string WrongRows(int column) const {
    std::string rows;
    for (int i = 0; i < rows_; ++i) {
      bool is_wrong = false;
      for (size_t k = 0; k < points_.size(); ++k) is_wrong |= Error(k, i, column) > tolerance_;
      if (is_wrong) rows += (rows.empty() ? "" : ", ") + std::to_string(i);
    }
    return rows;
  }

  static std::pair<std::string, std::string> DescribeFactor(double factor) {
    constexpr double kDegree = 3.14159265358979323846 / 180;
    if (std::abs(factor + 1) < 1e-4) return {"sign", "the sign is flipped"};
    const std::string sign = factor > 0 ? "" : ", and the sign is flipped";
    const double size = std::abs(factor);
    for (const auto& [value, words] :
         {std::pair(kDegree, "small"), std::pair(1 / kDegree, "large")}) {
      if (std::abs(size / value - 1) > 1e-4) continue;
      return {"degrees",
              Short("%.3f", 1 / kDegree) + " times too " + words + ": degrees for radians" + sign};
    }
    const double times = size >= 1 ? size : 1 / size;
    const int digits =
        times > 1.01 ? 3 : std::max(6, 2 - static_cast<int>(std::lround(std::log10(times - 1))));
    const std::string format = "%." + std::to_string(digits) + "f";
    return {"factor",
            Short(format.c_str(), times) + " times too " + (size >= 1 ? "large" : "small") + sign};
  }

  std::vector<CheckedBlock> blocks_;
  std::vector<CheckedPoint> points_;
  int rows_, columns_ = 0;
  double tolerance_;
  int num_skipped_;
  std::vector<double> scale_;  ///< points x rows x columns
  std::string verdict_;
  std::vector<GradientFinding> findings_;
  std::vector<GradientEntry> worst_;
};

inline std::ostream& operator<<(std::ostream& out, const GradientCheck& check) {
  return out << check.ToString();
}

}  // namespace bundle
