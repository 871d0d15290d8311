#include "file_format/sha256.hpp"

#include <algorithm>
#include <cstring>

namespace physkin {
namespace {

constexpr std::uint32_t kRounds[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

std::uint32_t turned(std::uint32_t word, int bits) { return word >> bits | word << (32 - bits); }

}  // namespace

void Sha256::update(const void* data, std::size_t size) {
  auto* at = static_cast<const unsigned char*>(data);
  std::size_t held = size_ % 64;
  size_ += size;
  while (size > 0) {
    if (held == 0 && size >= 64) {
      append_block(at);
      at += 64;
      size -= 64;
      continue;
    }
    const std::size_t taken = std::min(size, 64 - held);
    std::memcpy(pending_.data() + held, at, taken);
    held = (held + taken) % 64;
    if (held == 0) append_block(pending_.data());
    at += taken;
    size -= taken;
  }
}

std::string Sha256::digits() const {
  // The end: a one, zeros up to the last eight bytes of a block, and the number of bits.
  unsigned char end[72] = {0x80};
  const std::size_t zeros_end = (size_ % 64 < 56 ? 56 : 120) - size_ % 64;
  for (int k = 0; k < 8; ++k) end[zeros_end + k] = static_cast<unsigned char>(8 * size_ >> (56 - 8 * k));
  Sha256 whole = *this;
  whole.update(end, zeros_end + 8);

  std::string text;
  for (const std::uint32_t word : whole.state_) {
    for (int shift = 28; shift >= 0; shift -= 4) text += "0123456789abcdef"[word >> shift & 15];
  }
  return text;
}

void Sha256::append_block(const unsigned char* block) {
  std::uint32_t words[64];
  for (int t = 0; t < 16; ++t) {
    const unsigned char* bytes = block + 4 * t;
    words[t] = std::uint32_t(bytes[0]) << 24 | std::uint32_t(bytes[1]) << 16 | std::uint32_t(bytes[2]) << 8 | bytes[3];
  }
  for (int t = 16; t < 64; ++t) {
    const std::uint32_t near = words[t - 2], far = words[t - 15];
    words[t] = (turned(near, 17) ^ turned(near, 19) ^ near >> 10) + words[t - 7] +
               (turned(far, 7) ^ turned(far, 18) ^ far >> 3) + words[t - 16];
  }
  auto [a, b, c, d, e, f, g, h] = state_;
  for (int t = 0; t < 64; ++t) {
    const std::uint32_t first =
        h + (turned(e, 6) ^ turned(e, 11) ^ turned(e, 25)) + ((e & f) ^ (~e & g)) + kRounds[t] + words[t];
    const std::uint32_t second = (turned(a, 2) ^ turned(a, 13) ^ turned(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
    h = g;
    g = f;
    f = e;
    e = d + first;
    d = c;
    c = b;
    b = a;
    a = first + second;
  }
  const std::uint32_t changed[8] = {a, b, c, d, e, f, g, h};
  for (int k = 0; k < 8; ++k) state_[k] += changed[k];
}

}  // namespace physkin
