/* c_host_test FILE: checks options of older hosts, then counts what steps allocate and prints it. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "physkin.h"

static long allocations = 0;

void* __libc_malloc(size_t size);
void* __libc_calloc(size_t count, size_t size);
void* malloc(size_t size) { return ++allocations, __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return ++allocations, __libc_calloc(count, size); }

/* Options that end early, as in an older header, and nothing behind them that is the library's to read. */
static int older_options_are_taken(const char* path) {
  const physkin_options all = {sizeof all, 0, "fp32", "baseline"};
  for (uint32_t size = 0; size <= sizeof all; size += 4) {
    physkin_garment* garment;
    physkin_options* given = malloc(size < 4 ? 4 : size);
    memcpy(given, &all, size);
    given->size = size;
    const physkin_status status = physkin_open(path, given, &garment);
    free(given);
    if (size == 0) {
      if (status != PHYSKIN_BAD_ARGUMENT) return 0;
      continue;
    }
    if (status != PHYSKIN_OK) return 0;
    const int exact = strcmp(physkin_precision(garment), "fp32") == 0;
    const int plain = strcmp(physkin_instruction_set(garment), "baseline") == 0;
    physkin_close(garment);
    if (exact != (size >= offsetof(physkin_options, instruction_set))) return 0;
    if (size == sizeof all && !plain) return 0;
  }
  return 1;
}

int main(int argc, char** argv) {
  physkin_garment* garment;
  const float gravity[3] = {0.0f, 0.0f, -1.0f}, crash[3] = {100.0f, 0.0f, -9.81f};
  double root[7] = {0, 0, 0.9, 0, 0, 0, 1};
  float* pose;
  float* out;
  long before;
  if (argc != 2 || !older_options_are_taken(argv[1])) return 2;
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
