/* Counts what steps through the C interface allocate: c_host_test FILE prints it. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "physkin.h"

static long allocations = 0;

void* __libc_malloc(size_t size);
void* __libc_calloc(size_t count, size_t size);
void* malloc(size_t size) { return ++allocations, __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return ++allocations, __libc_calloc(count, size); }

int main(int argc, char** argv) {
  physkin_garment* garment;
  const float gravity[3] = {0.0f, 0.0f, -1.0f};
  float* pose;
  float* out;
  long before;
  if (argc != 2 || physkin_open(argv[1], NULL, &garment) != PHYSKIN_OK || allocations == 0) return 1;
  pose = calloc((size_t)physkin_joint_count(garment), sizeof *pose);
  out = calloc(6 * (size_t)physkin_vertex_count(garment), sizeof *out);
  before = allocations;
  for (int k = 0; k < 3; ++k) {
    pose[0] = 0.1f;
    if (physkin_step(garment, pose, gravity, out, 6, 6) != PHYSKIN_OK) return 1;
    pose[0] = NAN;
    if (physkin_step(garment, pose, gravity, out, 3, 6) != PHYSKIN_BAD_POSE) return 1;
  }
  printf("%ld\n", allocations - before);
  physkin_close(garment);
  return 0;
}
