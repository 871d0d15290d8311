// Prints the SHA-256 of each argument, taken in at once and in every pair of parts.
#include "file_format/sha256.hpp"

#include <cstdio>
#include <cstring>
#include <string>

namespace {

std::string digits_of(const std::string& text, std::size_t first) {
  physkin::Sha256 sha256;
  sha256.update(text.data(), first);
  sha256.update(text.data() + first, text.size() - first);
  return sha256.digits();
}

}  // namespace

int main(int argc, char** argv) {
  for (int k = 1; k < argc; ++k) {
    const std::string text = argv[k], whole = digits_of(text, text.size());
    for (std::size_t first = 0; first < text.size(); ++first) {
      if (digits_of(text, first) != whole) return 1;
    }
    std::printf("%s\n", whole.c_str());
  }
  return 0;
}
