// Aligned memory for everything a frame reads and writes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace physkin {

constexpr std::size_t kAlignment = 64;  // one cache line, and the widest vector register

// Hands out zeroed, 64-byte aligned arrays that live as long as the arena. Arrays taken one after the other lie one
// after the other, so that a frame streams through its network weights: chunks are large enough for most garments,
// since what a large array leaves of a chunk lies idle between others, which costs some processors a tenth of the time
// they need to read network weights from L3. What is never taken of a chunk is never touched.
class Arena {
 public:
  Arena() = default;
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  template <class T>
  T* take(std::size_t count) {
    static_assert(std::is_trivial_v<T>);
    const std::size_t bytes = round_up(count * sizeof(T), kAlignment);
    if (bytes > remaining_) add_chunk(bytes);
    std::byte* start = next_;
    std::fill_n(start, bytes, std::byte{});
    next_ += bytes;
    remaining_ -= bytes;
    touched_ += bytes;
    return reinterpret_cast<T*>(start);
  }

  template <class T>
  T* copy(const T* source, std::size_t count) {
    T* target = take<T>(count);
    if (count > 0) std::memcpy(target, source, count * sizeof(T));
    return target;
  }

  // Bytes of what was taken that a frame may touch: all but what was left out.
  std::size_t touched() const noexcept { return touched_; }
  void leave_out(std::size_t bytes) noexcept { touched_ -= bytes; }

 private:
  static constexpr std::size_t kHugePage = std::size_t{2} << 20, kChunk = 4 * kHugePage;
  static constexpr std::align_val_t kHugePages{kHugePage};

  static std::size_t round_up(std::size_t value, std::size_t step) { return (value + step - 1) / step * step; }

  void add_chunk(std::size_t bytes) {
    const std::size_t size = round_up(bytes, kChunk);
    std::unique_ptr<std::byte, Free> chunk(static_cast<std::byte*>(::operator new(size, kHugePages)));
#if defined(__linux__)
    // Network weights in small pages lie scattered over the caches' sets; refused, it is only slower.
    madvise(chunk.get(), size, MADV_HUGEPAGE);
#endif
    next_ = chunk.get();
    remaining_ = size;
    chunks_.push_back(std::move(chunk));
  }

  struct Free {
    void operator()(std::byte* memory) const { ::operator delete(memory, kHugePages); }
  };
  std::vector<std::unique_ptr<std::byte, Free>> chunks_;
  std::byte* next_ = nullptr;
  std::size_t remaining_ = 0, touched_ = 0;
};

}  // namespace physkin
