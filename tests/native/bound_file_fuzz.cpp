// Damages a bound garment file and feeds it to the C interface: cut off at every length, and with bytes changed anywhere.
//
//   bound_file_fuzz FILE ROUNDS     prints how many were loaded and how many were refused
//
// Built with the sanitizers, it stops at the first access out of bounds. Damaged files get a checksum that fits, as someone
// would give them who knows the format.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "physkin.h"

namespace {

constexpr std::size_t kHeader = 16;

std::mt19937 random_bits(2603);

std::size_t below(std::size_t limit) { return random_bits() % limit; }

// Bit by bit: not the code under test.
std::string sealed(std::string file) {
  std::uint32_t sum = ~0u;
  for (std::size_t at = kHeader; at < file.size(); ++at) {
    sum ^= static_cast<unsigned char>(file[at]);
    for (int bit = 0; bit < 8; ++bit) sum = sum >> 1 ^ (sum & 1 ? 0xedb88320u : 0);
  }
  sum = ~sum;
  if (file.size() >= kHeader) std::memcpy(&file[kHeader - 4], &sum, 4);
  return file;
}

// One to three bytes or words of it are others: small numbers, which sizes and kinds are, large ones, or any.
std::string damaged(std::string file) {
  static const std::uint32_t words[] = {0, 1, 2, 3, 7, 17, 50, 1u << 24, 1u << 31, ~0u, 0x7fc00000, 0x7f7fffff};
  for (std::size_t times = 1 + below(3); times > 0; --times) {
    const std::size_t at = kHeader + below(file.size() - kHeader - 4);
    if (below(2) == 0) {
      file[at] = char(random_bits());
    } else {
      std::memcpy(&file[at], &words[below(sizeof words / sizeof *words)], 4);
    }
  }
  return sealed(file);
}

// True if it was loaded; then frames of it must stay in bounds, whatever its numbers are.
bool survives(const std::string& file) {
  // At its exact size, and not aligned.
  std::vector<char> copy(file.size() + 1);
  std::memcpy(copy.data() + 1, file.data(), file.size());
  static const char* const precisions[] = {"fp32", "bf16", "int8"};
  physkin_options options = {sizeof options, precisions[below(3)], nullptr};
  physkin_garment* garment = nullptr;
  const physkin_status status = physkin_open_memory(copy.data() + 1, file.size(), &options, &garment);
  if (status != PHYSKIN_OK) {
    if ((status != PHYSKIN_BAD_FILE && status != PHYSKIN_OUT_OF_MEMORY) || garment != nullptr) std::abort();
    if (physkin_last_error()[0] == '\0') std::abort();
    return false;
  }
  std::vector<float> pose(std::size_t(physkin_joint_count(garment)), 0.3f);
  const float gravity[3] = {0, 0, -1};
  std::vector<float> out(6 * std::size_t(physkin_vertex_count(garment)));
  const physkin_status step = physkin_step(garment, pose.data(), gravity, out.data(), 6, 6);
  if (step != PHYSKIN_OK && step != PHYSKIN_BAD_POSE) std::abort();
  for (std::size_t at = 0; step == PHYSKIN_OK && at < out.size(); ++at) {
    if (!(out[at] > -1e30f && out[at] < 1e30f)) std::abort();  // swallowed on the way
  }
  physkin_close(garment);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  std::ifstream stream(argv[1], std::ios::binary);
  const std::string file{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!survives(file)) return 1;
  for (std::size_t size = 0; size < file.size(); size += size < 3000 ? 1 : 37) {
    if (survives(sealed(file.substr(0, size)))) std::abort();
  }
  int loaded = 0;
  const int rounds = std::atoi(argv[2]);
  for (int round = 0; round < rounds; ++round) loaded += survives(damaged(file));
  std::printf("%d loaded, %d refused\n", loaded, rounds - loaded);
  return 0;
}
