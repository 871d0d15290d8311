// The kernels that take the time of a frame and of encoding a body, and the data layouts they work on. Each instruction
// set has its own compiled copy (kernel_unit.cpp); dispatch.hpp chooses one.
#pragma once

#include <cstddef>
#include <cstdint>

#include "kernels/packed_layer.hpp"

namespace physkin {

// Vertices in blocks of kBlock that share most of their garment nodes. Skinning weights are dense over the block's
// union of garment nodes, so that every lane does the same work on the same broadcast matrix. First come those of the
// first half of its vertices alone, then those of both, then those of the second half alone: narrower registers leave out
// what is not theirs.
constexpr int kBlock = 16, kHalf = kBlock / 2;

struct NodeRange {
  std::int32_t begin, end;
};

// Nodes of the blocks, a row each, and the weights of a block's vertices.
template <class Start, class Weight>
struct NodeRows {
  const NodeRange* halves = nullptr;  // (block_count, 2) of each half into the next two
  const Start* start = nullptr;       // (rows,) where a node's matrix or offset starts [floats]
  const Weight* weight = nullptr;     // (rows, kBlock) in units, zeros beyond vertex_count
};

struct WideRows {
  NodeRows<std::int32_t, float> influences;
  NodeRows<std::int32_t, std::int16_t> details;  // none without detail
  const std::int32_t* vertex = nullptr;          // (block_count, kBlock) index in the caller's order
};

// The same in fewer bytes. Heavy are garment nodes that a vertex of the block goes with by more than a byte of units.
struct NarrowRows {
  NodeRows<std::uint16_t, std::uint8_t> influences;
  NodeRows<std::uint16_t, std::int16_t> heavy_influences;
  NodeRows<std::uint16_t, std::uint8_t> details;
  const std::uint16_t* vertex = nullptr;
};

struct SkinningBlocks {
  int vertex_count = 0, block_count = 0;
  bool is_narrow = false;
  WideRows wide;                    // where it is not
  NarrowRows narrow;                // where it is
  float unit = 1, detail_unit = 0;  // of garment nodes' and of detail nodes' weights
  const float* rest = nullptr;      // (block_count, 3, kBlock): x, y, z
  const float* normals = nullptr;   // (block_count, 3, kBlock) at rest, read only where they are carried along
};

// Where vertices go: a row of floats each, x y z or x y z nx ny nz, `stride` floats from row to row. Rows need no
// alignment: a serialised message may place them anywhere.
struct VertexRows {
  unsigned char* data = nullptr;
  std::ptrdiff_t stride = 0;
  bool with_normals = false;
  bool has_fourth = false;  // rows without normals: there is room for a fourth number, which may become anything
};

// Vertices in groups of kRingGroup with rings of one length: the faces around a vertex join it with every two neighbours
// that follow each other in its ring, which closes. Where faces do not go all around, the vertex itself is in its ring;
// shorter rings of a group repeat their last neighbour. Neither adds a face that has an area. Lengths are even.
constexpr int kRingGroup = 16;

template <class Index>
struct RingIndices {
  // (group_count, kRingGroup) in the caller's order. Where vertices do not fill the groups, the first one is there more
  // than once: only its last place holds its position, and is written after the others.
  const Index* vertex = nullptr;
  const Index* neighbour = nullptr;  // (steps, kRingGroup) where its place begins [8 bytes]
};

struct FaceRings {
  int group_count = 0;
  const std::int32_t* start = nullptr;  // (group_count + 1,) of steps
  RingIndices<std::uint16_t> narrow;    // where they fit, or else
  RingIndices<std::uint32_t> wide;
  float* places = nullptr;  // (group_count, kRingGroup, 4) positions in order of the vertices
};

// The body encoder works on tiles of kTokens tokens, feature by feature: tile[feature][kTokens], 64-byte aligned.
constexpr int kTokens = 64;
constexpr float kLayerNormEpsilon = 1e-5f;

struct LayerNorm {
  int width = 0;
  const float* weight = nullptr;  // (width,)
  const float* bias = nullptr;    // (width,)
};

// One head's keys and values (head_width, kTokens) in every tile, `tile_stride` floats from tile to tile.
struct TokenAttention {
  int head_width = 0, count = 0;  // tokens that exist; those that fill up the last tile are no keys
  float scale = 1.0f;
  const float* keys = nullptr;
  const float* values = nullptr;
  std::ptrdiff_t tile_stride = 0;
};

constexpr std::size_t attention_scratch(int head_width) { return (std::size_t(head_width) + kTokens + 2) * kTokens; }

// What a dense kernel computes: output = activation((1 + scale) * (W input + bias) + shift). scale and
// shift may both be null (no modulation). input must be 64-byte aligned and readable to a multiple of 64 bytes. Writes
// padded_to_group(outputs) floats and reads as many of scale and shift; those beyond outputs are unspecified.
struct DenseCall {
  const float* input = nullptr;
  const float* scale = nullptr;
  const float* shift = nullptr;
  // int8: room for the inputs as 16-bit integers, or their high bytes and then the low ones; a value for each input of
  // the widest layer and kGroup more, 64-byte aligned.
  std::int16_t* quantised = nullptr;
  float* output = nullptr;
};

using DenseKernel = void (*)(const PackedLayer& layer, Activation activation, const DenseCall& call);

// A body's trunk, of limb separation: a radius about an axis, by height along it, in quadratic B-splines, and direction, a
// Fourier series; its bones take over from each other with height, from the first one up.
constexpr int kTrunkWaves = 9, kTrunkPoints = 16;

struct TrunkField {
  int bones = 0, splines = 0;
  float x = 0, y = 0, low = 0, high = 0, blend = 0;  // where the axis is, between which heights, and over how much
  const float* back = nullptr;                       // (bones, 3, 4) from the posed point to the canonical one
  const float* heights = nullptr;                    // (bones,) that a bone takes over at
  const float* coefficients = nullptr;               // (splines, kTrunkWaves)
};

// Points of the skin with normals, in blocks that lie together and face alike. Posed; arrays are aligned.
constexpr int kSkinBlock = 8, kSkinRow = 8;

struct SkinBlocks {
  int count = 0;                   // of blocks, a multiple of kBlock
  const float* points = nullptr;   // (count * kSkinBlock, kSkinRow) x, y, z [m], normal, and two that are unspecified
  const float* middles = nullptr;  // (count, kSkinRow) the same of the blocks themselves
  const float* columns = nullptr;  // (6, count) of these: x, y, z and normal
  const float* radii = nullptr;    // (count,) [m] of each about its middle
};

// Room for what a block of cloth may meet, of `count` blocks of skin: (2, count / 64 rounded up) bits, (count + 1,) blocks,
// (count (kSkinBlock + 1) + 2,) of these and of points that are listed, (count + 1, kBlock) what blocks add to squared
// distances, and (count * kSkinBlock, kBlock) of these. Aligned.
struct ContactRoom {
  std::uint64_t* bits = nullptr;
  std::int32_t *blocks = nullptr, *listed = nullptr;
  float *turned = nullptr, *squares = nullptr;
};

// Samples of cloth that may touch far places of its own, in blocks. Aligned.
struct ClothBlocks {
  int count = 0, rooms = 0;               // of blocks, and these with those that fill the last registers up
  const std::int32_t* samples = nullptr;  // (count * kBlock,)
  const float* rows = nullptr;            // (all samples, kSkinRow) as points of the skin
  float* columns = nullptr;               // (6, count * kBlock) x, y, z [m] and normal
  float* boxes = nullptr;                 // (6, rooms) lowest and highest x, y, z
  float* listed = nullptr;                // (count * kBlock, kSkinRow) room
};

// Logarithm of how many times faster, or slower, a gate lets the oscillators of a sway network run at most.
constexpr float kMostSpeedUp = 1.5f;

// Oscillators of a sway network (evaluator/learnt_sway.hpp). Arrays are 64-byte aligned, and readable and writable
// to a multiple of 64 bytes.

struct Oscillators {
  int count = 0;
  const float *rates = nullptr, *turns = nullptr;               // [1/s], [rad/s]
  const float *rest_real = nullptr, *rest_imaginary = nullptr;  // turn what drives one to where it comes to rest
  float *real = nullptr, *imaginary = nullptr;                  // states
};

struct Kernels {
  const char* instruction_set;
  PackedLayout layout;

  // By Precision, and whether instructions fetch network weights ahead of time, which changes no bit (dispatch.hpp).
  DenseKernel dense[kPrecisionCount][2];

  // x' = M x and normal' = normalised cofactors(A) normal, with M = [A | c] = sum_k w_k M_k, M_k in matrices (nodes,
  // 12). A normal becomes zero where A flattens the cloth to a line. offsets: (detail nodes, 3) that are added to x
  // before, null where the blocks have no detail.
  void (*skin)(const SkinningBlocks& blocks, const float* matrices, const float* offsets, const VertexRows& rows);

  // Writes places, and unit normals of the faces around each, weighted by their areas; +Z where they cancel out.
  void (*ring_normals)(FaceRings rings, VertexRows rows);

  // Points (3, count) to contacts (4, count): how deep [m], and the normal outwards. Aligned; count is a multiple of
  // kTrunkPoints.
  void (*trunk_depth)(const TrunkField& field, const float* points, int count, float* contacts);

  // Where a block of cloth is from the skin. cloth: (kBlock, kSkinRow), as points of the skin. sides: (skin.count,) of each block of
  // skin, 1 where it is beneath the cloth, -1 where it presses on it, 0 where the two never meet. planes (5, kBlock):
  // distance [m], normal, and in how far that holds, 0 to 1. False, and nothing written, where no skin is near.
  bool (*meet_skin)(const SkinBlocks& skin, const float* cloth, const std::int16_t* sides, const ContactRoom& room,
                    float* planes);

  // Writes columns and boxes of blocks. Then, where one of these blocks is from those that it
  // has a side for, as meet_skin; sides: (rooms,) 1 where they are beneath it, 2 where they lie over it, -1 where they press
  // on it. False where it is clear of all of them.
  void (*bound_cloth)(const ClothBlocks& cloth);
  bool (*meet_cloth)(const ClothBlocks& cloth, int block, const std::int16_t* sides, float* planes);

  // Over `elapsed` seconds, or, where that is negative, to where they come to rest. driven: (3, count) real and
  // imaginary parts of what drives them, and gates; readable for kGroup floats beyond.
  void (*oscillate)(const Oscillators& oscillators, const float* driven, float elapsed);

  // output tile = activation(W tile + bias), for none and relu.
  void (*token_linear)(const DenseWeights& layer, const float* tile, Activation activation, float* output);

  // tile = layer norm of (tile + added), over the features of each token.
  void (*token_norm)(const LayerNorm& norm, const float* added, float* tile);

  // Overwrites the queries (head_width, kTokens) of one tile with softmax(scale * query keys) values.
  void (*token_attention)(const TokenAttention& attention, float* query, float* scratch);
};

}  // namespace physkin
