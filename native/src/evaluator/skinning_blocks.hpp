// Packs a garment's vertices for the skinning kernel.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

SkinningBlocks pack_skinning_blocks(const SkinningData& data, Arena& arena);

}  // namespace physkin
