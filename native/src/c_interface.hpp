// What the sources of the plain C interface share: what failed last, exceptions as a status, and options.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <stdexcept>

#include "evaluator/skinner.hpp"
#include "file_format/bound_file.hpp"
#include "garment/finite.hpp"
#include "kernels/kernels.hpp"
#include "physkin.h"

namespace physkin::c_interface {

const char* last_error() noexcept;

// Sets it, as std::printf would print it, and returns the status.
[[gnu::format(printf, 2, 3)]] physkin_status fail(physkin_status status, const char* format, ...) noexcept;

// Any exception of `work` as a status.
template <class Work>
physkin_status guarded(Work work) noexcept {
  try {
    return work();
  } catch (const FileError& error) {
    return fail(PHYSKIN_BAD_FILE, "%s", error.what());
  } catch (const std::invalid_argument& error) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", error.what());
  } catch (const std::bad_alloc&) {
    return fail(PHYSKIN_OUT_OF_MEMORY, "%s", "out of memory");
  } catch (const std::exception& error) {
    return fail(PHYSKIN_FAILED, "%s", error.what());
  } catch (...) {
    return fail(PHYSKIN_FAILED, "%s", "unknown failure");
  }
}

// Of rows that a frame is written into.
physkin_status check_rows(std::int32_t columns, std::ptrdiff_t stride) noexcept;

// PHYSKIN_BAD_POSE for what a frame was refused for.
physkin_status fail(const Rejection& bad) noexcept;

// What is computed by, from options that may be null. Throws std::invalid_argument.
struct Wanted {
  explicit Wanted(const physkin_options* given);

  const Kernels* kernels;
  Precision precision;
};

}  // namespace physkin::c_interface
