// SHA-256 (FIPS 180-4): whether a file still holds what was written.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

namespace physkin {

class Sha256 {
 public:
  void update(const void* data, std::size_t size);

  // 64 hexadecimal digits, in lower case, of all that came so far.
  std::string digits() const;

 private:
  void append_block(const unsigned char* block);

  std::array<std::uint32_t, 8> state_{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  std::array<unsigned char, 64> pending_{};  // the block that is not full yet
  std::uint64_t size_ = 0;
};

}  // namespace physkin
