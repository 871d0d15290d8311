// Packs a garment's vertices for the skinning kernel.
#pragma once

#include "arena.hpp"
#include "kernels.hpp"

namespace physkin {

SkinningBlocks pack_skinning_blocks(const BoundGarment& garment, Arena& arena);

}  // namespace physkin
