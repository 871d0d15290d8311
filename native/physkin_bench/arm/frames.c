/* frames FILE COUNT INSTRUCTION_SET: drapes a bound file so many times, each joint swaying by itself. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "physkin.h"

int main(int argc, char** argv) {
  physkin_garment* garment;
  if (argc != 4) return 2;
  const physkin_options options = {sizeof options, 0, NULL, argv[3]};
  if (physkin_open(argv[1], &options, &garment) != PHYSKIN_OK) {
    fprintf(stderr, "%s\n", physkin_last_error());
    return 1;
  }
  const int joints = physkin_joint_count(garment);
  float* pose = calloc((size_t)joints, sizeof *pose);
  float* rows = calloc(6 * (size_t)physkin_vertex_count(garment), sizeof *rows);
  const double root[7] = {0, 0, 0, 0, 0, 0, 1};
  for (int frame = 0; frame < atoi(argv[2]); ++frame) {
    for (int k = 0; k < joints; ++k) {
      float lower, rest, upper;
      physkin_joint_range(garment, k, &lower, &rest, &upper);
      pose[k] = rest + 0.2f * (upper - lower) * sinf(0.1f * (float)frame + (float)k);
    }
    if (physkin_step_moving(garment, pose, frame / 60.0, root, rows, 6, 6) != PHYSKIN_OK) return 1;
  }
  return 0;
}
