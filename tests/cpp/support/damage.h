#pragma once

/// Seeded damage to the bytes of a file.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <random>
#include <string>
#include <string_view>
#include <vector>

namespace bundle::testing {

class Damage {
 public:
  explicit Damage(uint64_t seed) : random_(seed) {}

  /// `bytes` with one kind of damage, each in turn.
  std::string Next(const std::string& bytes) {
    if (bytes.empty()) return bytes;
    switch (turn_++ % 7) {
      case 0:
        return FlipBit(bytes);
      case 1:
        return OverwriteWord(bytes);
      case 2:
        return ReplaceToken(bytes);
      case 3:
        return std::string(bytes).erase(Below(bytes.size()), kLengths[Below(5)]);
      case 4:
        return std::string(bytes).insert(Below(bytes.size()), kLengths[Below(5)],
                                         static_cast<char>(Below(256)));
      case 5:
        return std::string(bytes).insert(Below(bytes.size()),
                                         bytes.substr(Below(bytes.size()), kLengths[Below(5)]));
      default:
        return bytes.substr(0, Below(bytes.size()));
    }
  }

 private:
  static constexpr size_t kLengths[] = {1, 2, 4, 8, 100};

  size_t Below(size_t end) { return random_() % end; }

  std::string FlipBit(std::string bytes) {
    char& byte = bytes[Below(bytes.size())];
    byte = static_cast<char>(byte ^ (1 << Below(8)));
    return bytes;
  }

  /// An extreme value where a binary format may keep a count, an id or a double.
  std::string OverwriteWord(std::string bytes) {
    static constexpr uint64_t kWords[] = {0,
                                          1,
                                          0xffffffff,
                                          0x7fffffff,
                                          0x80000000,
                                          0xffffffffffffffff,
                                          0x7fffffffffffffff,
                                          0x8000000000000000,
                                          uint64_t{1} << 62,
                                          0x7ff0000000000000,   // infinity
                                          0x7ff8000000000000,   // NaN
                                          0x2000000000000000};  // x 8 overflows
    const uint64_t word = kWords[Below(std::size(kWords))];
    const size_t size = Below(2) == 0 ? 4 : 8;
    if (bytes.size() < size) return bytes;
    std::memcpy(&bytes[Below(bytes.size() - size + 1)], &word, size);
    return bytes;
  }

  /// An ugly number where a text has a fine one.
  std::string ReplaceToken(std::string bytes) {
    static const std::vector<std::string> kTokens = {"nan",
                                                     "-inf",
                                                     "1e999",
                                                     "1e-999",
                                                     "-1",
                                                     "2147483648",
                                                     "4294967295",
                                                     "4294967296",
                                                     "-9223372036854775808",
                                                     "18446744073709551615",
                                                     "18446744073709551616",
                                                     "1.5",
                                                     "0x10",
                                                     "+",
                                                     "1e",
                                                     "#",
                                                     "\n",
                                                     std::string("\0", 1),
                                                     "\xff\xfe",
                                                     std::string(5000, '7'),
                                                     std::string(5000, 'A')};
    constexpr std::string_view kSpace = " \n\t";
    const size_t begin = bytes.find_first_not_of(kSpace, Below(bytes.size()));
    if (begin == std::string::npos) return bytes;
    const size_t end = std::min(bytes.find_first_of(kSpace, begin), bytes.size());
    return bytes.replace(begin, end - begin, kTokens[Below(kTokens.size())]);
  }

  std::mt19937_64 random_;
  size_t turn_ = 0;
};

}  // namespace bundle::testing
