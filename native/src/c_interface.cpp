#include "c_interface.hpp"

#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <string>

#include "kernels/dispatch.hpp"

namespace physkin::c_interface {
namespace {

// Of fixed size: telling what is wrong allocates nothing either.
thread_local char last[512] = "";

}  // namespace

const char* last_error() noexcept { return last; }

physkin_status fail(physkin_status status, const char* format, ...) noexcept {
  std::va_list values;
  va_start(values, format);
  std::vsnprintf(last, sizeof last, format, values);
  va_end(values);
  return status;
}

physkin_status check_rows(std::int32_t columns, std::ptrdiff_t stride) noexcept {
  if (columns != 3 && columns != 6) return fail(PHYSKIN_BAD_ARGUMENT, "columns is %d; must be 3 or 6", int(columns));
  if (stride >= columns) return PHYSKIN_OK;
  return fail(PHYSKIN_BAD_ARGUMENT, "stride is %ld floats; must be %d or more", long(stride), int(columns));
}

physkin_status fail(const Rejection& bad) noexcept {
  return fail(PHYSKIN_BAD_POSE, "%s[%ld] is %g; every value must be finite and within +-%g", bad.name, long(bad.index),
              double(bad.value), double(bad.limit));
}

Wanted::Wanted(const physkin_options* given) {
  if (given != nullptr && given->size < sizeof *given) {
    throw std::invalid_argument("options.size is " + std::to_string(given->size) +
                                "; set it to sizeof(physkin_options)");
  }
  const physkin_options options = given == nullptr ? physkin_options{} : *given;
  kernels = &select_kernels(options.instruction_set == nullptr ? "" : options.instruction_set);
  precision = select_precision(options.precision == nullptr ? "" : options.precision);
}

}  // namespace physkin::c_interface
