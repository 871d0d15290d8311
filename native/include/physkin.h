/* PhySkin for hosts other than Python: joint positions in, garment vertices and normals out. Plain C99.
 *
 * A host loads a bound garment, a file that holds one garment on one body, or an outfit of several, written once by
 *     physkin bind AVATAR --garment MODEL [--garment MODEL ...] -o NAME.physkin
 * and then calls physkin_step every frame. docs/c-host.md shows how, and how to convert to Unity's axes.
 *
 * Metres, radians; root frame of the body: right-handed, X forward, Y left, Z up.
 * Functions that can fail return a status and leave the reason in physkin_last_error. No exception leaves this library.
 * Different garments may be used by different threads at once; one garment by one thread at a time. */
#ifndef PHYSKIN_H
#define PHYSKIN_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32) && defined(PHYSKIN_BUILDS_LIBRARY)
#define PHYSKIN_API __declspec(dllexport)
#elif defined(_WIN32)
#define PHYSKIN_API __declspec(dllimport)
#else
#define PHYSKIN_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Raised when a host built against an older header would break. */
#define PHYSKIN_ABI_VERSION 4

/* ABI version of the loaded library; compare it with PHYSKIN_ABI_VERSION before anything else. */
PHYSKIN_API int32_t physkin_abi_version(void);

typedef enum physkin_status {
  PHYSKIN_OK = 0,
  PHYSKIN_BAD_ARGUMENT = 1, /* null pointer, unknown option, buffer layout */
  PHYSKIN_BAD_FILE = 2,     /* cannot be read, damaged, or another version */
  PHYSKIN_BAD_POSE = 3,     /* a value, or what the networks make of it, is not finite or too large; out is unchanged */
  PHYSKIN_OUT_OF_MEMORY = 4,
  PHYSKIN_FAILED = 5 /* anything else */
} physkin_status;

/* What failed last in this thread: the bad value, and what was allowed. Never null; valid until the next failure. */
PHYSKIN_API const char* physkin_last_error(void);

typedef struct physkin_garment physkin_garment;

/* A null pointer in place of options, or of a string in them, means the default. */
typedef struct physkin_options {
  uint32_t size;               /* sizeof(physkin_options) */
  const char* precision;       /* of network weights: "fp32", "bf16", "int8" (default) */
  const char* instruction_set; /* "baseline", "v3", "v3_vnni", "v4", "v4_vnni"; default the widest of this processor */
} physkin_options;

/* Loads a bound garment from a file (UTF-8 path) or from memory, which may be freed afterwards. */
PHYSKIN_API physkin_status physkin_open(const char* path, const physkin_options* options, physkin_garment** garment);
PHYSKIN_API physkin_status physkin_open_memory(const void* data, size_t size, const physkin_options* options,
                                               physkin_garment** garment);
PHYSKIN_API void physkin_close(physkin_garment* garment); /* null is allowed */

PHYSKIN_API int32_t physkin_vertex_count(const physkin_garment* garment);
PHYSKIN_API int32_t physkin_joint_count(const physkin_garment* garment);
PHYSKIN_API int32_t physkin_face_count(const physkin_garment* garment);
PHYSKIN_API const int32_t* physkin_faces(const physkin_garment* garment); /* (faces, 3), counter-clockwise outside */

/* An outfit's garments are parts of one mesh, from the skin outwards: one part where the file holds one garment. */
PHYSKIN_API int32_t physkin_part_count(const physkin_garment* garment);

/* Name of a part's garment model (UTF-8), null for an index out of range. */
PHYSKIN_API const char* physkin_part_name(const physkin_garment* garment, int32_t part);

/* Which vertices and faces are a part's: the first of each, and how many. Faces name vertices of the whole mesh. */
PHYSKIN_API physkin_status physkin_part_range(const physkin_garment* garment, int32_t part, int32_t* first_vertex,
                                              int32_t* vertex_count, int32_t* first_face, int32_t* face_count);

/* Name of a fabric that a part can be made of; null for an index out of range. The first is what the file was made in. */
PHYSKIN_API const char* physkin_fabric_name(const physkin_garment* garment, int32_t part, int32_t fabric);

/* From the next frame on the part hangs as that fabric does, one of its names; at any time. */
PHYSKIN_API physkin_status physkin_set_fabric(physkin_garment* garment, int32_t part, const char* name);

/* Name of a joint (a scalar degree of freedom), null for an index out of range. */
PHYSKIN_API const char* physkin_joint_name(const physkin_garment* garment, int32_t joint);
PHYSKIN_API physkin_status physkin_joint_range(const physkin_garment* garment, int32_t joint, float* lower, float* rest,
                                               float* upper);

/* Unit axis (3) that the joint turns its bone about, root frame, body in the canonical A-pose. Joints of one bone are
 * applied in their order: a bone's rotation relative to its parent is the product of its joints' rotations, each about
 * its axis by the joint position minus rest. */
PHYSKIN_API physkin_status physkin_joint_axis(const physkin_garment* garment, int32_t joint, float* axis);

/* One frame, for a root that is not accelerated. Allocates nothing.
 * joint_positions: one a joint. gravity: unit direction in the root frame, (0, 0, -1) for an upright body.
 * out: a row a vertex, `stride` floats from row to row: x y z, and with columns = 6 also the unit normal. columns: 3 or
 * 6; stride: columns or more. Buffers need no alignment beyond a float's. */
PHYSKIN_API physkin_status physkin_step(physkin_garment* garment, const float* joint_positions, const float* gravity,
                                        float* out, int32_t columns, ptrdiff_t stride);

/* The same for an accelerated root. effective_gravity: gravity minus the root's acceleration [m/s2], root frame; zero in
 * free fall, at most 3 x 9.81 long, else PHYSKIN_BAD_POSE. */
PHYSKIN_API physkin_status physkin_step_accelerated(physkin_garment* garment, const float* joint_positions,
                                                    const float* effective_gravity, float* out, int32_t columns,
                                                    ptrdiff_t stride);

/* The same for a root that moves through the world: cloth lags, swings, settles, and does not leap. time [s], of any
 * clock; frames come in their order, at any rate. root: (7) where it is in a world with Z up: x, y, z [m], and its unit
 * quaternion x, y, z, w, world <- root. After a gap, a jump or a clock that goes back cloth comes to rest by itself.
 * PHYSKIN_BAD_POSE for a time or root that cannot be. */
PHYSKIN_API physkin_status physkin_step_moving(physkin_garment* garment, const float* joint_positions, double time,
                                               const double* root, float* out, int32_t columns, ptrdiff_t stride);

/* How much cloth swings in physkin_step_moving, from 0, not at all, to 1, the default; at any time. */
PHYSKIN_API physkin_status physkin_set_sway(physkin_garment* garment, double amount);

/* Velocity [m/s] (3) of the air from now on, at most 13 m/s, else PHYSKIN_BAD_ARGUMENT; until then it is still. It is given
 * in the world of physkin_step_moving's root; for physkin_step in the level frame that faces the same way as the root.
 * physkin_step_accelerated takes no wind: its effective gravity is meant to include it. */
PHYSKIN_API physkin_status physkin_set_wind(physkin_garment* garment, const double* velocity);

/* Cloth hangs still in the next physkin_step_moving, as in the first. */
PHYSKIN_API physkin_status physkin_reset(physkin_garment* garment);

/* Precision and instruction set in use; names as in physkin_options. */
PHYSKIN_API const char* physkin_precision(const physkin_garment* garment);
PHYSKIN_API const char* physkin_instruction_set(const physkin_garment* garment);

/* --- Garments that somebody else poses: a ROS node's ~/mesh once, then its ~/garment_nodes, some 19 KB a frame --- */

/* What skinning needs of a physkin_msgs/GarmentMesh; members are its fields, and arrays as long as it says of them. Read by
 * physkin_skinner_open only. detail_node_count and detail_influences are 0, and detail arrays null, of one without detail. */
typedef struct physkin_mesh {
  uint32_t size; /* sizeof(physkin_mesh) */
  int32_t vertex_count, face_count, node_count, influences, detail_node_count, detail_influences;
  const uint32_t* faces; /* (face_count, 3), null where face_count is 0 */
  const float* rest_vertices;
  const float* rest_normals;
  const float* node_rest;
  const uint32_t* influence_nodes;
  const float* influence_weights;
  const uint32_t* detail_nodes;
  const float* detail_weights;
} physkin_mesh;

typedef struct physkin_skinner physkin_skinner;

/* options.precision does not matter here: there are no network weights. PHYSKIN_BAD_ARGUMENT for a mesh that contradicts
 * itself. */
PHYSKIN_API physkin_status physkin_skinner_open(const physkin_mesh* mesh, const physkin_options* options,
                                                physkin_skinner** skinner);
PHYSKIN_API void physkin_skinner_close(physkin_skinner* skinner); /* null is allowed */

/* One frame. Allocates nothing. transforms: (node_count, 3, 4) and detail_offsets: (detail_node_count, 3), null of a
 * garment without detail, as in physkin_msgs/GarmentNodes. out, columns and stride as of physkin_step. */
PHYSKIN_API physkin_status physkin_skin(physkin_skinner* skinner, const float* transforms, const float* detail_offsets,
                                        float* out, int32_t columns, ptrdiff_t stride);

#ifdef __cplusplus
}
#endif

#endif
