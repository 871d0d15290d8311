// Frames through the C interface on every instruction set and in every precision: counts what they allocate, of a garment
// alone and of it twice, worn together, which must give the same bits.
//
//   frame_test ALONE TWICE [ALONE TWICE ...]    bound files; prints "<instruction set> <precision> <allocations>" of each
//
// All buffers have their exact size, so that a build with the address sanitizer finds what reads or writes beyond them.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "physkin.h"

static long allocations = 0;

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define __SANITIZE_ADDRESS__  // as GCC says it
#endif
#endif

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)
// Every way to the heap, operator new included, ends in one of these.
extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
void* malloc(size_t size) { return ++allocations, __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return ++allocations, __libc_calloc(count, size); }
void* realloc(void* memory, size_t size) { return ++allocations, __libc_realloc(memory, size); }
void* aligned_alloc(size_t alignment, size_t size) { return ++allocations, __libc_memalign(alignment, size); }
}
#endif

namespace {

void require(bool good) {
  if (good) return;
  std::fprintf(stderr, "ERROR: %s\n", physkin_last_error());
  std::exit(2);
}

struct Cloth {
  physkin_garment* garment = nullptr;
  std::vector<float> rows, positions;

  Cloth(const char* path, const physkin_options& options) {
    if (physkin_open(path, &options, &garment) == PHYSKIN_BAD_ARGUMENT) return;  // a set that this processor lacks
    require(garment != nullptr);
    rows.resize(6 * std::size_t(physkin_vertex_count(garment)));
    positions.resize(rows.size() / 2);
    const double wind[3] = {3, -1, 0};
    require(physkin_set_wind(garment, wind) == PHYSKIN_OK);
  }
  ~Cloth() { physkin_close(garment); }

  // In each fabric, with normals and without.
  void step(const float* joints, int frame) {
    const double root[7] = {0.1 * frame, 0.2, 1, 0, 0, 0, 1};
    for (int part = 0; part < physkin_part_count(garment); ++part) {
      require(physkin_set_fabric(garment, part, physkin_fabric_name(garment, part, frame % 2)) == PHYSKIN_OK);
    }
    require(physkin_step_moving(garment, joints, 0.01 * frame, root, positions.data(), 3, 3) == PHYSKIN_OK);
    require(physkin_step_moving(garment, joints, 0.01 * frame, root, rows.data(), 6, 6) == PHYSKIN_OK);
  }
};

}  // namespace

int main(int argc, char** argv) {
  for (const char* set : {"baseline", "v3", "v3_vnni", "v4", "v4_vnni", "dotprod", "i8mm"}) {
    for (const char* precision : {"fp32", "bf16", "int8"}) {
      for (int file = 1; file + 1 < argc; file += 2) {
        const physkin_options options = {sizeof options, precision, set};
        Cloth alone(argv[file], options), twice(argv[file + 1], options);
        if (alone.garment == nullptr) continue;
        std::vector<float> joints(std::size_t(physkin_joint_count(alone.garment)));
        for (std::size_t k = 0; k < joints.size(); ++k) joints[k] = 0.1f * float(k % 7) - 0.3f;
        const long before = allocations;
        for (int frame = 0; frame < 4; ++frame) {
          alone.step(joints.data(), frame);
          twice.step(joints.data(), frame);
#if !defined(__SANITIZE_ADDRESS__)  // whose checks stand between products and sums that are fused elsewhere
          const std::size_t bytes = sizeof(float) * alone.rows.size();
          require(std::memcmp(alone.rows.data(), twice.rows.data(), bytes) == 0);
          require(std::memcmp(alone.rows.data(), twice.rows.data() + alone.rows.size(), bytes) == 0);
#endif
        }
        std::printf("%s %s %ld\n", set, precision, allocations - before);
      }
    }
  }
  return allocations > 0 ? 0 : 1;  // zero: the counting itself did not work
}
