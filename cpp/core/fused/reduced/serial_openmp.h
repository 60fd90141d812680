#pragma once

// Of whatever OpenMP runtime CHOLMOD brings; null if it was built without.
extern "C" {
__attribute__((weak)) int omp_get_max_active_levels();
__attribute__((weak)) void omp_set_max_active_levels(int levels);
}

namespace bundle::fused {

/// While this lives, OpenMP regions that the calling thread meets run on it alone. Debian 12's
/// CHOLMOD scatters the columns of every supernode with four OpenMP threads, on any machine and
/// whatever is asked for, and these then spin: on two cores a factorisation of 2 Gflop took 0.21 s
/// of processor time with them and 0.09 s without.
class SerialOpenMp {
 public:
  SerialOpenMp() {
    if (omp_set_max_active_levels == nullptr) return;
    saved_levels_ = omp_get_max_active_levels();
    omp_set_max_active_levels(0);
  }
  ~SerialOpenMp() {
    if (omp_set_max_active_levels != nullptr) omp_set_max_active_levels(saved_levels_);
  }
  SerialOpenMp(const SerialOpenMp&) = delete;
  SerialOpenMp& operator=(const SerialOpenMp&) = delete;

 private:
  int saved_levels_ = 0;
};

}  // namespace bundle::fused
