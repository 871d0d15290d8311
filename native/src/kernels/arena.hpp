// Aligned memory for everything a frame reads and writes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include "kernels/huge_pages.hpp"

namespace physkin {

// Hands out zeroed, 64-byte aligned arrays that live as long as the arena. Arrays taken one after the other lie one
// after the other, so that a frame streams through its network weights: chunks are large enough for most garments,
// since what a large array leaves of a chunk lies idle between others, which costs some processors a tenth of the time
// they need to read network weights from L3. What is never taken of a chunk is never touched.
class Arena {
 public:
  Arena() = default;
  // For less than most garments.
  explicit Arena(std::size_t chunk) : chunk_(chunk) {}
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
  // All since so many were touched; returns how many these are.
  std::size_t leave_out_since(std::size_t touched) noexcept {
    const std::size_t bytes = touched_ - touched;
    touched_ = touched;
    return bytes;
  }

  // Keeps alive what arrays of this arena go with, of which a frame may touch so many bytes.
  void keep(std::shared_ptr<const void> other, std::size_t touched) {
    kept_.push_back(std::move(other));
    touched_ += touched;
  }

  // Leaves to others what has not been taken.
  void close() {
    if (!chunks_.empty()) chunks_.back().shorten(chunks_.back().size() - remaining_);
    remaining_ = 0;
  }

 private:
  void add_chunk(std::size_t bytes) {
    close();
    chunks_.emplace_back(std::max(bytes, chunk_));
    next_ = chunks_.back().start();
    remaining_ = chunks_.back().size();
  }

  std::size_t chunk_ = 4 * kHugePage;
  std::vector<HugeSpan> chunks_;
  std::vector<std::shared_ptr<const void>> kept_;
  std::byte* next_ = nullptr;
  std::size_t remaining_ = 0, touched_ = 0;
};

}  // namespace physkin
