#pragma once

#include <cholmod.h>

namespace bundle {

/// CHOLMOD's workspace and settings for its orderings, silent: what went wrong is in
/// `common.status`. Its 64-bit functions throughout, as a matrix may have more than 2^31 values.
class CholmodSession {
 public:
  CholmodSession() {
    cholmod_l_start(&common);
    common.print = 0;
    common.try_catch = 1;
    common.error_handler = nullptr;
    // The default moves rows of more than 10 sqrt(n) entries to the end, unordered. In the graph of
    // a photo collection these are most of its rows.
    common.method[0].prune_dense = -1;
  }
  ~CholmodSession() { cholmod_l_finish(&common); }
  CholmodSession(const CholmodSession&) = delete;
  CholmodSession& operator=(const CholmodSession&) = delete;

  cholmod_common common;
};

}  // namespace bundle
