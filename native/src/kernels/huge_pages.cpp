#include "kernels/huge_pages.hpp"

#include <algorithm>
#include <iterator>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace physkin {
namespace {

constexpr std::align_val_t kAtHugePage{kHugePage};

// Elsewhere memory that is never touched may be there all the same.
#if defined(__linux__)
constexpr std::size_t kRegion = 32 * kHugePage;
#else
constexpr std::size_t kRegion = 4 * kHugePage;
#endif

}  // namespace

void HugeRegion::Free::operator()(std::byte* memory) const { ::operator delete(memory, kAtHugePage); }

HugeRegion::HugeRegion(std::size_t bytes)
    : memory_(static_cast<std::byte*>(::operator new(bytes, kAtHugePage))), free_{{0, bytes}} {
#if defined(__linux__)
  // Network weights in small pages lie scattered over the caches' sets; refused, it is only slower.
  madvise(memory_.get(), bytes, MADV_HUGEPAGE);
#endif
}

std::byte* HugeRegion::take(std::size_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto room = std::find_if(free_.begin(), free_.end(), [&](const auto& each) { return each.second >= bytes; });
  if (room == free_.end()) return nullptr;
  const auto [start, length] = *room;
  free_.erase(room);
  if (length > bytes) free_.emplace(start + bytes, length - bytes);
  return memory_.get() + start;
}

void HugeRegion::give_back(std::byte* start, std::size_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  auto room = free_.emplace(std::size_t(start - memory_.get()), bytes).first;
  if (const auto next = std::next(room); next != free_.end() && room->first + room->second == next->first) {
    room->second += next->second;
    free_.erase(next);
  }
  if (room == free_.begin()) return;
  if (const auto before = std::prev(room); before->first + before->second == room->first) {
    before->second += room->second;
    free_.erase(room);
  }
}

HugeSpan::HugeSpan(std::size_t bytes) : size_(round_up(bytes, kAlignment)) {
  static std::mutex mutex;
  static std::vector<std::weak_ptr<HugeRegion>> regions;
  const std::lock_guard<std::mutex> lock(mutex);
  regions.erase(std::remove_if(regions.begin(), regions.end(), [](const auto& each) { return each.expired(); }),
                regions.end());
  for (const auto& each : regions) {
    region_ = each.lock();
    start_ = region_ == nullptr ? nullptr : region_->take(size_);
    if (start_ != nullptr) return;
  }
  region_ = std::make_shared<HugeRegion>(round_up(size_, kRegion));
  regions.push_back(region_);
  start_ = region_->take(size_);
}

void HugeSpan::shorten(std::size_t bytes) {
  bytes = round_up(bytes, kAlignment);
  if (region_ == nullptr || bytes >= size_) return;
  region_->give_back(start_ + bytes, size_ - bytes);
  size_ = bytes;
}

}  // namespace physkin
