// Damages a bound garment file in every way that comes to mind and feeds it to the C interface.
//
//   bound_file_fuzz FILE ROUNDS     prints how many were loaded and how many were refused
//
// Built with the sanitizers, it stops at the first access out of bounds. Numbers are changed mostly in the header:
// sizes, offsets, types and names decide what is read. Most files are sealed again, with a digest that fits, as someone
// would who knows the format.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "file_format/tensor_file.hpp"
#include "physkin.h"

namespace {

std::mt19937 random_bits(2603);

std::size_t below(std::size_t limit) { return random_bits() % limit; }

std::size_t header_end(const std::string& file) {
  std::uint64_t size = 0;
  if (file.size() >= 8) std::memcpy(&size, file.data(), 8);
  return std::size_t(size) + 8 < file.size() ? std::size_t(size) + 8 : file.size();
}

// Replaces one number of the header by another, keeping the header's length where it can.
void change_number(std::string& file) {
  static const char* const values[] = {"0",
                                       "1",
                                       "2",
                                       "3",
                                       "17",
                                       "4294967295",
                                       "9223372036854775807",
                                       "18446744073709551615",
                                       "99999999999999999999999",
                                       "-1",
                                       "1e9",
                                       "2.5"};
  const std::size_t end = header_end(file);
  std::size_t begin = 8 + below(end - 8);
  while (begin < end && !std::isdigit(static_cast<unsigned char>(file[begin]))) ++begin;
  std::size_t stop = begin;
  while (stop < end && std::isdigit(static_cast<unsigned char>(file[stop]))) ++stop;
  const std::string value = values[below(sizeof values / sizeof *values)];
  file.replace(begin, stop - begin, value);
  const std::uint64_t size = std::uint64_t(end - 8 + value.size() - (stop - begin));
  if (below(4) != 0) std::memcpy(&file[0], &size, 8);
}

void change_text(std::string& file) {
  static const char* const texts[] = {"F32",     "I32", "F16", "U8", "\"", "\\", "\\u12",
                                      "\\ud800", "[",   "]",   "{",  "}",  ",",  ":"};
  const std::string text = texts[below(sizeof texts / sizeof *texts)];
  file.replace(8 + below(header_end(file) - 8), text.size(), text);
}

void change_value(std::string& file) {
  static const float values[] = {std::numeric_limits<float>::quiet_NaN(),
                                 std::numeric_limits<float>::infinity(),
                                 3e38f,
                                 -3e38f,
                                 1e-45f,
                                 0.0f,
                                 1e6f,
                                 -1.0f};
  const std::size_t begin = header_end(file);
  if (file.size() < begin + 8) return;
  std::memcpy(&file[begin + below((file.size() - begin) / 4) * 4], &values[below(sizeof values / sizeof *values)], 4);
}

// With a digest that fits, where the header can be read.
std::string sealed(std::string file) {
  try {
    const physkin::TensorFile content(reinterpret_cast<const unsigned char*>(file.data()), file.size());
    const std::string& old = content.metadata(physkin::kDigest);
    const std::size_t at = file.find(old);
    if (old.size() == content.digest().size() && at != file.npos) file.replace(at, old.size(), content.digest());
  } catch (const physkin::FileError&) {
  }
  return file;
}

std::string damaged(std::string file) {
  for (std::size_t times = 1 + below(3); times > 0 && file.size() > 16; --times) {
    switch (below(6)) {
      case 0: file.resize(below(file.size())); break;
      case 1: file[below(file.size())] = char(random_bits()); break;
      case 2: change_text(file); break;
      case 3: change_value(file); break;
      default: change_number(file);
    }
  }
  return below(8) == 0 ? file : sealed(file);
}

// True if it was loaded; then frames of it must stay in bounds, whatever its numbers are.
bool survives(const std::string& file) {
  // At its exact size, and not aligned.
  std::vector<char> copy(file.size() + 1);
  std::memcpy(copy.data() + 1, file.data(), file.size());
  static const char* const precisions[] = {"fp32", "bf16", "int8"};
  physkin_options options = {sizeof options, int32_t(below(2)), precisions[below(3)], nullptr};
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
  int loaded = 0;
  const int rounds = std::atoi(argv[2]);
  for (int round = 0; round < rounds; ++round) loaded += survives(damaged(file));
  std::printf("%d loaded, %d refused\n", loaded, rounds - loaded);
  return 0;
}
