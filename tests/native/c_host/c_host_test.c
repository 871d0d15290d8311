/* c_host_test FILE: counts what steps allocate and prints it. */
#include <math.h>
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
  const float gravity[3] = {0.0f, 0.0f, -1.0f}, crash[3] = {100.0f, 0.0f, -9.81f};
  double root[7] = {0, 0, 0.9, 0, 0, 0, 1};
  float* pose;
  float* out;
  long before;
  if (argc != 2) return 2;
  if (physkin_open(argv[1], NULL, &garment) != PHYSKIN_OK || allocations == 0) return 1;
  pose = calloc((size_t)physkin_joint_count(garment), sizeof *pose);
  out = calloc(6 * (size_t)physkin_vertex_count(garment), sizeof *out);
  before = allocations;
  for (int k = 0; k < 3; ++k) {
    pose[0] = 0.1f;
    if (physkin_step(garment, pose, gravity, out, 6, 6) != PHYSKIN_OK) return 1;
    if (physkin_step_accelerated(garment, pose, gravity, out, 6, 6) != PHYSKIN_OK) return 1;
    if (physkin_step_accelerated(garment, pose, crash, out, 6, 6) != PHYSKIN_BAD_POSE) return 1;
    root[0] += 0.02;
    if (physkin_step_moving(garment, pose, k / 60.0, root, out, 6, 6) != PHYSKIN_OK) return 1;
    if (physkin_step_moving(garment, pose, NAN, root, out, 6, 6) != PHYSKIN_BAD_POSE) return 1;
    if (physkin_set_sway(garment, 0.5) != PHYSKIN_OK || physkin_set_sway(garment, 2) != PHYSKIN_BAD_ARGUMENT) return 1;
    if (physkin_set_wind(garment, root) != PHYSKIN_OK) return 1;
    if (physkin_reset(garment) != PHYSKIN_OK) return 1;
    pose[0] = NAN;
    if (physkin_step(garment, pose, gravity, out, 3, 6) != PHYSKIN_BAD_POSE) return 1;
  }
  printf("%ld\n", allocations - before);
  physkin_close(garment);
  return 0;
}
