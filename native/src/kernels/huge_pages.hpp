// Memory in huge pages, in which everything that a frame reads and writes lies closely, whichever evaluator's it is.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <mutex>

namespace physkin {

constexpr std::size_t kAlignment = 64;  // one cache line, and the widest vector register
constexpr std::size_t kHugePage = std::size_t{2} << 20;

// A few huge pages that several spans share. What no span had is never touched, and takes no memory.
class HugeRegion {
 public:
  explicit HugeRegion(std::size_t bytes);
  // Null where there is no room; bytes: a multiple of kAlignment.
  std::byte* take(std::size_t bytes);
  void give_back(std::byte* start, std::size_t bytes);

 private:
  struct Free {
    void operator()(std::byte* memory) const;
  };
  std::unique_ptr<std::byte, Free> memory_;
  std::mutex mutex_;
  std::map<std::size_t, std::size_t> free_;  // where room starts, and how much there is
};

// So many bytes, aligned, as they were left by whoever had them before; for any thread.
class HugeSpan {
 public:
  explicit HugeSpan(std::size_t bytes);
  HugeSpan(HugeSpan&& other) noexcept = default;
  HugeSpan& operator=(HugeSpan&&) = delete;
  ~HugeSpan() { shorten(0); }

  std::byte* start() const { return start_; }
  std::size_t size() const { return size_; }
  // Gives back what is beyond so many bytes.
  void shorten(std::size_t bytes);

 private:
  std::shared_ptr<HugeRegion> region_;  // null of one that was moved from
  std::byte* start_ = nullptr;
  std::size_t size_ = 0;
};

constexpr std::size_t round_up(std::size_t value, std::size_t step) { return (value + step - 1) / step * step; }

}  // namespace physkin
