/* Drapes a garment in one pose and prints it as a Wavefront OBJ:
 *     drape shirt.physkin [JOINT RADIANS]... > shirt.obj */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "physkin.h"

int main(int argc, char** argv) {
  physkin_garment* garment;
  if (physkin_abi_version() != PHYSKIN_ABI_VERSION || argc < 2 || argc % 2 != 0) return 2;
  if (physkin_open(argv[1], NULL, &garment) != PHYSKIN_OK) {
    fprintf(stderr, "%s\n", physkin_last_error());
    return 1;
  }
  const int32_t joints = physkin_joint_count(garment), vertices = physkin_vertex_count(garment);
  float* pose = malloc((size_t)joints * sizeof *pose);
  float* rows = malloc((size_t)vertices * 6 * sizeof *rows);
  if (pose == NULL || rows == NULL) return 1;
  float lower, upper;
  for (int32_t j = 0; j < joints; ++j) physkin_joint_range(garment, j, &lower, &pose[j], &upper);
  for (int k = 2; k < argc; k += 2) {
    int32_t j = 0;
    while (j < joints && strcmp(argv[k], physkin_joint_name(garment, j)) != 0) ++j;
    if (j == joints) {
      fprintf(stderr, "no joint %s\n", argv[k]);
      return 2;
    }
    pose[j] = strtof(argv[k + 1], NULL);
  }
  const float gravity[3] = {0.0f, 0.0f, -1.0f}; /* of an upright body */
  if (physkin_step(garment, pose, gravity, rows, 6, 6) != PHYSKIN_OK) { /* once a frame */
    fprintf(stderr, "%s\n", physkin_last_error());
    return 1;
  }
  for (const float* v = rows; v < rows + 6 * vertices; v += 6) {
    printf("v %.9g %.9g %.9g\nvn %.9g %.9g %.9g\n", v[0], v[1], v[2], v[3], v[4], v[5]);
  }
  const int32_t* face = physkin_faces(garment);
  for (int32_t k = 0; k < physkin_face_count(garment); ++k, face += 3) {
    printf("f %d %d %d\n", face[0] + 1, face[1] + 1, face[2] + 1);
  }
  physkin_close(garment);
  free(pose);
  free(rows);
  return 0;
}
