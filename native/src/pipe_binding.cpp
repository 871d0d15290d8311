// The part of physkin_core._native that reads what another process has written, without the interpreter's lock.
#include "pipe_binding.hpp"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Clock = std::chrono::steady_clock;
using Bytes = nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

enum class Outcome { filled, gone, late, interrupted, failed };

// Where reading goes on: the buffer, and how much of it is filled.
struct Place {
  std::size_t buffer = 0, filled = 0;
};

Outcome fill(int pipe, const std::vector<Bytes>& into, const std::optional<Clock::time_point>& deadline, Place& at) {
  while (at.buffer < into.size()) {
    const Bytes& buffer = into[at.buffer];
    if (at.filled == buffer.size()) {
      at = {at.buffer + 1, 0};
      continue;
    }
    int wait = -1;  // [ms]; for ever
    if (deadline) {
      const double left = std::chrono::duration<double, std::milli>(*deadline - Clock::now()).count();
      if (left <= 0) return Outcome::late;
      wait = int(std::ceil(std::min(left, 1e9)));
    }
    pollfd waiting{pipe, POLLIN, 0};
    const int ready = poll(&waiting, 1, wait);
    if (ready < 0) return errno == EINTR ? Outcome::interrupted : Outcome::failed;
    if (ready == 0) continue;
    const ssize_t count = read(pipe, buffer.data() + at.filled, buffer.size() - at.filled);
    if (count < 0) return errno == EINTR ? Outcome::interrupted : Outcome::failed;
    if (count == 0) return Outcome::gone;
    at.filled += std::size_t(count);
  }
  return Outcome::filled;
}

void raise(PyObject* kind, const char* what) {
  PyErr_SetString(kind, what);
  throw nb::python_error();
}

void read_pipe(int pipe, const std::vector<Bytes>& into, std::optional<double> seconds) {
  std::optional<Clock::time_point> deadline;
  if (seconds)
    deadline = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(*seconds));
  Place at;
  for (;;) {
    const Outcome outcome = [&] {
      const nb::gil_scoped_release release;
      return fill(pipe, into, deadline, at);
    }();
    switch (outcome) {
      case Outcome::filled: return;
      case Outcome::gone: raise(PyExc_EOFError, "the other end has gone"); break;
      case Outcome::late: raise(PyExc_TimeoutError, "the other end has not answered in time"); break;
      case Outcome::failed: PyErr_SetFromErrno(PyExc_OSError); throw nb::python_error();
      case Outcome::interrupted:
        if (PyErr_CheckSignals() != 0) throw nb::python_error();
    }
  }
}

}  // namespace

void bind_pipe(nb::module_& module) {
  module.def(
      "read_pipe", read_pipe, "pipe"_a, "into"_a.noconvert(), "seconds"_a.none(),
      "Fills arrays of bytes from a file descriptor, other threads running meanwhile. Raises EOFError, TimeoutError "
      "or OSError.");
}

}  // namespace physkin
