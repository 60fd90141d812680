#include <fcntl.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <map>
#include <string>
#include <thread>
#include <utility>

namespace py = pybind11;

// Prints one line when mpirun ends all processes: after Ctrl-C, or because a process was lost.
//
// mpirun (Open MPI 5) then sends SIGCONT to the others, SIGTERM a quarter of a second later, and
// SIGKILL at once after it. The main thread may be in a sum that never ends, with or without the
// GIL. So a thread without Python waits for these signals, which all other threads block. At
// SIGCONT, which can have other causes (`fg`), it finds the lost processes. At SIGTERM there is
// only time to print a line.
//
// An error may reach all processes. The process that creates the mark prints the line. The mark is
// a file in the folder that mpirun creates for its processes on one machine and removes later.
// mpirun does not forward output at this point, so the line goes to the standard error of mpirun,
// the parent process.

namespace {

constexpr int kExitEnded = 128 + SIGTERM;

/// Processes on this machine by rank, set once and never freed.
std::atomic<const std::map<int, int>*> known_processes{nullptr};

bool TakeTheWord(const std::string& mark) {
  if (mark.empty()) return false;
  const int file = open(mark.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
  if (file >= 0) close(file);
  return file >= 0;
}

/// Returns a descriptor of the standard error of the parent or, if that fails, of this process.
int StandardErrorOfParent() {
  const pid_t parent = getppid();
#if defined(SYS_pidfd_open) && defined(SYS_pidfd_getfd)
  const long handle = syscall(SYS_pidfd_open, parent, 0);  // NOLINT(google-runtime-int)
  if (handle >= 0) {
    const long found = syscall(SYS_pidfd_getfd, handle, STDERR_FILENO, 0);  // NOLINT
    close(static_cast<int>(handle));
    if (found >= 0) return static_cast<int>(found);
  }
#endif
  // This fails if a process may only trace its children. Opening a file again would write from its
  // beginning.
  const std::string path = "/proc/" + std::to_string(parent) + "/fd/2";
  struct stat kind{};
  if (stat(path.c_str(), &kind) == 0 && !S_ISREG(kind.st_mode)) {
    const int opened = open(path.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC);
    if (opened >= 0) return opened;
  }
  return STDERR_FILENO;
}

void Say(int file, const std::string& line) {
  [[maybe_unused]] const ssize_t written = write(file, line.data(), line.size());
}

void Wait(const sigset_t& signals, const std::string& mark, int num_processes) {
  int file = STDERR_FILENO;
  for (int signal = 0;;) {
    if (sigwait(&signals, &signal) != 0 || signal == SIGTERM) break;
    if (file == STDERR_FILENO) file = StandardErrorOfParent();
    const std::map<int, int>* processes = known_processes.load();
    if (processes == nullptr) continue;
    for (const auto& [rank, pid] : *processes) {
      if (kill(pid, 0) == 0 || errno != ESRCH) continue;
      if (TakeTheWord(mark)) {
        Say(file, "error: process " + std::to_string(rank) + " of " +
                      std::to_string(num_processes) + " was lost\n");
      }
      break;
    }
  }
  if (TakeTheWord(mark)) Say(file, "error: ended by mpirun: Ctrl-C, or a process was lost\n");
  _exit(kExitEnded);
}

void WaitForTheEnd(const std::string& mark, int num_processes) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGCONT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);  // in all threads to come, too
  std::thread([=] { Wait(signals, mark, num_processes); }).detach();
}

}  // namespace

void BindLauncher(py::module_& m) {
  m.def("wait_for_the_end", &WaitForTheEnd, py::arg("mark"), py::arg("num_processes"));
  m.def(
      "know_processes",
      [](std::map<int, int> pid_of_rank) {
        known_processes = new std::map<int, int>(std::move(pid_of_rank));
      },
      py::arg("pid_of_rank"));
  m.def("take_the_word", &TakeTheWord, py::arg("mark"));
}
