// What evaluators of a process have in common, such as the network weights of one garment model on many bodies: made
// once, and there as long as one of them is.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>

#include "kernels/arena.hpp"

namespace physkin {

// Tells contents apart by 128 bits: no two that are not equal are ever met.
class Digest {
 public:
  template <class T>
  Digest& add(const T* values, std::size_t count) {
    static_assert(std::is_trivial_v<T>);
    const std::size_t bytes = count * sizeof(T);
    const auto* at = reinterpret_cast<const unsigned char*>(values);
    std::size_t done = 0;
    for (; done + sizeof(lanes_) <= bytes; done += sizeof(lanes_)) mix(at + done, sizeof(lanes_));
    if (done < bytes) mix(at + done, bytes - done);
    return add_size(bytes);
  }
  template <class T>
  Digest& add(const T& value) {
    return add(&value, 1);
  }

  std::array<std::uint64_t, 2> value() const {
    std::array<std::uint64_t, 2> folded = {lanes_[0], lanes_[1]};
    for (int k = 0; k < 2; ++k) folded[k] = mixed(mixed(folded[k], lanes_[2 + k]), lanes_[3 - k]);
    return folded;
  }

 private:
  // One to one in either argument.
  static std::uint64_t mixed(std::uint64_t lane, std::uint64_t word) {
    lane = (lane ^ word) * 0x9e3779b97f4a7c15u;
    return lane ^ lane >> 32;
  }
  void mix(const unsigned char* bytes, std::size_t count) {
    std::array<std::uint64_t, 4> words = {};
    std::memcpy(words.data(), bytes, count);
    for (int k = 0; k < 4; ++k) lanes_[k] = mixed(lanes_[k], words[k]);
  }
  Digest& add_size(std::size_t bytes) {
    for (std::uint64_t& lane : lanes_) lane = mixed(lane, bytes);
    return *this;
  }

  std::array<std::uint64_t, 4> lanes_ = {1, 2, 3, 4};
};

// The T that `make`, given an arena, makes of contents with this digest: kept by `arena`, and made only where no other
// arena keeps it. For any thread.
template <class T, class Make>
T shared_in(Arena& arena, const Digest& digest, Make make) {
  struct Made {
    explicit Made(Make& make) : value(make(arena)) { arena.close(); }
    Arena arena{kHugePage};
    T value;
  };
  static std::mutex mutex;
  static std::map<std::array<std::uint64_t, 2>, std::weak_ptr<const Made>> all;
  const auto key = digest.value();
  const auto known = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    const auto found = all.find(key);
    return found == all.end() ? nullptr : found->second.lock();
  };
  std::shared_ptr<const Made> made = known();
  if (made == nullptr) {
    made = std::make_shared<const Made>(make);
    const std::lock_guard<std::mutex> lock(mutex);
    for (auto each = all.begin(); each != all.end();) each = each->second.expired() ? all.erase(each) : std::next(each);
    all[key] = made;
  }
  arena.keep(made, made->arena.touched());
  return made->value;
}

}  // namespace physkin
