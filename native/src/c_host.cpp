// The plain C interface of include/physkin.h.
#include <algorithm>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "c_interface.hpp"
#include "file_format/bound_file.hpp"
#include "kernels/dispatch.hpp"
#include "outfit/evaluator.hpp"
#include "physkin.h"
#include "sway/frame_input.hpp"

struct physkin_garment {
  // What of the whole mesh is one garment's.
  struct Part {
    std::string name;
    std::int32_t first_vertex = 0, vertex_count = 0, first_face = 0, face_count = 0;
    std::vector<std::string> fabrics;
  };

  physkin_garment(const physkin::BoundFile& file, const physkin::c_interface::Wanted& how)
      : evaluator(file.garments, *how.kernels, how.precision),
        input(int(file.garments.size())),
        rows(file.garments.size()),
        joint_names(file.joint_names) {
    const physkin::BoundGarment& first = file.garments.front();
    const auto dofs = std::size_t(first.dofs);
    lower.assign(first.dof_lower, first.dof_lower + dofs);
    rest.assign(first.dof_rest, first.dof_rest + dofs);
    upper.assign(first.dof_upper, first.dof_upper + dofs);
    axes.assign(first.dof_axis, first.dof_axis + 3 * dofs);
    for (std::size_t k = 0; k < file.garments.size(); ++k)
      add_part(file.garment_names[k], file.garments[k], file.fabric_names[k]);
    for (const physkin::BoundOrder& order : file.orders) {
      evaluator.keep_order({order.steady, order.yielding}, order.data);
    }
  }

  void add_part(const std::string& name, const physkin::BoundGarment& garment,
                const std::vector<std::string>& fabrics) {
    parts.push_back(
        {name, vertex_count, garment.vertex_count, std::int32_t(faces.size() / 3), garment.face_count, fabrics});
    for (std::size_t k = 0; k < 3 * std::size_t(garment.face_count); ++k) {
      faces.push_back(vertex_count + garment.faces[k]);
    }
    vertex_count += garment.vertex_count;
  }

  physkin::Evaluator evaluator;
  physkin::FrameInput input;
  std::vector<physkin::VertexRows> rows;  // of a frame, one a part
  std::vector<std::string> joint_names;
  std::vector<float> lower, rest, upper, axes;
  std::vector<Part> parts;
  std::vector<std::int32_t> faces;
  std::int32_t vertex_count = 0;
};

using physkin::c_interface::fail;
using physkin::c_interface::guarded;
using physkin::c_interface::Wanted;

namespace {

physkin_status bad_joint(const physkin_garment* garment, int32_t joint) {
  return fail(PHYSKIN_BAD_ARGUMENT, "joint is %d; must be from 0 to %d", int(joint), garment->evaluator.dofs() - 1);
}

// Null for a part that is not there.
const physkin_garment::Part* part_of(const physkin_garment* garment, int32_t part) {
  const bool inside = part >= 0 && part < physkin_part_count(garment);
  return inside ? &garment->parts[std::size_t(part)] : nullptr;
}

physkin_status bad_part(const physkin_garment* garment, int32_t part) {
  return fail(PHYSKIN_BAD_ARGUMENT, "part is %d; must be from 0 to %d", int(part), physkin_part_count(garment) - 1);
}

physkin_status open(const unsigned char* data, std::size_t size, const physkin_options* given,
                    physkin_garment** garment) {
  const Wanted how(given);
  const physkin::BoundFile file(data, size);
  try {
    *garment = std::make_unique<physkin_garment>(file, how).release();
  } catch (const std::invalid_argument& error) {
    throw physkin::FileError(error.what());
  }
  return PHYSKIN_OK;
}

// A frame of what `begin` tells the garment's input; `given` are the numbers that it may refuse, and what they are told
// by.
template <class Begin>
physkin_status step(physkin_garment* garment, const float* joint_positions, const void* given, float* out,
                    int32_t columns, ptrdiff_t stride, Begin begin) {
  if (garment == nullptr || joint_positions == nullptr || given == nullptr || out == nullptr) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment, joint_positions, gravity or root, or out is null");
  }
  if (const physkin_status status = physkin::c_interface::check_rows(columns, stride)) return status;
  if (const physkin_status status = begin(garment->input)) return status;
  for (std::size_t k = 0; k < garment->rows.size(); ++k) {
    float* const first = out + garment->parts[k].first_vertex * stride;
    garment->rows[k] = {reinterpret_cast<unsigned char*>(first), stride, columns == 6};
  }
  const auto* rows = garment->rows.data();
  if (const physkin::Rejection bad = garment->evaluator.step(joint_positions, garment->input.rows(), rows)) {
    return fail(bad);
  }
  return PHYSKIN_OK;
}

// The same of a frame that stands by itself, under a gravity (3) of a root at rest, or of one that is accelerated.
physkin_status still_step(physkin_garment* garment, const float* joint_positions, const float* gravity, float* out,
                          int32_t columns, ptrdiff_t stride, bool accelerated) {
  return step(garment, joint_positions, gravity, out, columns, stride, [&](physkin::FrameInput& input) {
    const double vector[3] = {gravity[0], gravity[1], gravity[2]};
    if (const char* wrong = accelerated ? input.accelerate(vector, nullptr) : input.hang(vector)) {
      return fail(PHYSKIN_BAD_POSE, "%s, got (%g, %g, %g)", wrong, vector[0], vector[1], vector[2]);
    }
    input.begin_still_frame();
    return PHYSKIN_OK;
  });
}

}  // namespace

extern "C" {

int32_t physkin_abi_version(void) { return PHYSKIN_ABI_VERSION; }

const char* physkin_last_error(void) { return physkin::c_interface::last_error(); }

physkin_status physkin_open(const char* path, const physkin_options* options, physkin_garment** garment) {
  if (path == nullptr || garment == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "path or garment is null");
  *garment = nullptr;
  return guarded([&] {
    std::ifstream stream(path, std::ios::binary);
    std::string data;
    std::vector<char> part(std::size_t{1} << 20);
    while (data.size() <= physkin::kLargestFile &&
           stream.read(part.data(), std::streamsize(part.size())).gcount() > 0) {
      data.append(part.data(), std::size_t(stream.gcount()));
    }
    if (data.empty()) return fail(PHYSKIN_BAD_FILE, "cannot read %.200s, or it is empty", path);
    return open(reinterpret_cast<const unsigned char*>(data.data()), data.size(), options, garment);
  });
}

physkin_status physkin_open_memory(const void* data, size_t size, const physkin_options* options,
                                   physkin_garment** garment) {
  if (data == nullptr || garment == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "data or garment is null");
  *garment = nullptr;
  return guarded([&] { return open(static_cast<const unsigned char*>(data), size, options, garment); });
}

void physkin_close(physkin_garment* garment) { delete garment; }

int32_t physkin_vertex_count(const physkin_garment* garment) { return garment->vertex_count; }
int32_t physkin_joint_count(const physkin_garment* garment) { return garment->evaluator.dofs(); }
int32_t physkin_face_count(const physkin_garment* garment) { return int32_t(garment->faces.size() / 3); }
const int32_t* physkin_faces(const physkin_garment* garment) { return garment->faces.data(); }

int32_t physkin_part_count(const physkin_garment* garment) { return int32_t(garment->parts.size()); }

const char* physkin_part_name(const physkin_garment* garment, int32_t part) {
  const physkin_garment::Part* found = part_of(garment, part);
  return found == nullptr ? nullptr : found->name.c_str();
}

const char* physkin_fabric_name(const physkin_garment* garment, int32_t part, int32_t fabric) {
  const physkin_garment::Part* found = part_of(garment, part);
  const bool inside = found != nullptr && fabric >= 0 && fabric < int32_t(found->fabrics.size());
  return inside ? found->fabrics[std::size_t(fabric)].c_str() : nullptr;
}

physkin_status physkin_set_fabric(physkin_garment* garment, int32_t part, const char* name) {
  if (garment == nullptr || name == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment or name is null");
  const physkin_garment::Part* found = part_of(garment, part);
  if (found == nullptr) return bad_part(garment, part);
  const auto fabric = std::find(found->fabrics.begin(), found->fabrics.end(), name);
  if (fabric == found->fabrics.end()) {
    std::string allowed;
    for (const std::string& each : found->fabrics) allowed += (allowed.empty() ? "" : ", ") + each;
    return fail(PHYSKIN_BAD_ARGUMENT, "the file holds no fabric %.60s of %.60s; it holds %.200s", name,
                found->name.c_str(), allowed.c_str());
  }
  garment->evaluator.set_fabric(part, int(fabric - found->fabrics.begin()) - 1);
  return PHYSKIN_OK;
}

physkin_status physkin_part_range(const physkin_garment* garment, int32_t part, int32_t* first_vertex,
                                  int32_t* vertex_count, int32_t* first_face, int32_t* face_count) {
  if (garment == nullptr || first_vertex == nullptr || vertex_count == nullptr || first_face == nullptr ||
      face_count == nullptr) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment, first_vertex, vertex_count, first_face or face_count is null");
  }
  const physkin_garment::Part* found = part_of(garment, part);
  if (found == nullptr) return bad_part(garment, part);
  *first_vertex = found->first_vertex;
  *vertex_count = found->vertex_count;
  *first_face = found->first_face;
  *face_count = found->face_count;
  return PHYSKIN_OK;
}

const char* physkin_joint_name(const physkin_garment* garment, int32_t joint) {
  const bool inside = joint >= 0 && joint < physkin_joint_count(garment);
  return inside ? garment->joint_names[std::size_t(joint)].c_str() : nullptr;
}

physkin_status physkin_joint_axis(const physkin_garment* garment, int32_t joint, float* axis) {
  if (garment == nullptr || axis == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment or axis is null");
  if (joint < 0 || joint >= physkin_joint_count(garment)) return bad_joint(garment, joint);
  std::copy_n(garment->axes.begin() + 3 * std::ptrdiff_t(joint), 3, axis);
  return PHYSKIN_OK;
}

physkin_status physkin_joint_range(const physkin_garment* garment, int32_t joint, float* lower, float* rest,
                                   float* upper) {
  if (garment == nullptr || lower == nullptr || rest == nullptr || upper == nullptr) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment, lower, rest or upper is null");
  }
  if (joint < 0 || joint >= physkin_joint_count(garment)) return bad_joint(garment, joint);
  *lower = garment->lower[std::size_t(joint)];
  *rest = garment->rest[std::size_t(joint)];
  *upper = garment->upper[std::size_t(joint)];
  return PHYSKIN_OK;
}

physkin_status physkin_step(physkin_garment* garment, const float* joint_positions, const float* gravity, float* out,
                            int32_t columns, ptrdiff_t stride) {
  return still_step(garment, joint_positions, gravity, out, columns, stride, false);
}

physkin_status physkin_step_accelerated(physkin_garment* garment, const float* joint_positions,
                                        const float* effective_gravity, float* out, int32_t columns, ptrdiff_t stride) {
  return still_step(garment, joint_positions, effective_gravity, out, columns, stride, true);
}

physkin_status physkin_step_moving(physkin_garment* garment, const float* joint_positions, double time,
                                   const double* root, float* out, int32_t columns, ptrdiff_t stride) {
  return step(garment, joint_positions, root, out, columns, stride, [&](physkin::FrameInput& input) {
    const char* wrong = input.move(time, root);
    if (wrong == nullptr) wrong = input.begin_frame(time);
    return wrong == nullptr ? PHYSKIN_OK : fail(PHYSKIN_BAD_POSE, "%s", wrong);
  });
}

physkin_status physkin_set_sway(physkin_garment* garment, double amount) {
  if (garment == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment is null");
  if (!(amount >= 0 && amount <= 1)) return fail(PHYSKIN_BAD_ARGUMENT, "sway must be from 0 to 1, got %g", amount);
  for (int k = 0; k < garment->input.count(); ++k) garment->input.set_sway(k, amount);
  return PHYSKIN_OK;
}

physkin_status physkin_set_wind(physkin_garment* garment, const double* velocity) {
  if (garment == nullptr || velocity == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment or velocity is null");
  if (const char* wrong = garment->input.set_wind(velocity)) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s, got (%g, %g, %g)", wrong, velocity[0], velocity[1], velocity[2]);
  }
  return PHYSKIN_OK;
}

physkin_status physkin_reset(physkin_garment* garment) {
  if (garment == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "garment is null");
  garment->input.reset();
  garment->evaluator.forget();
  return PHYSKIN_OK;
}

const char* physkin_precision(const physkin_garment* garment) {
  return physkin::precision_name(garment->evaluator.precision());
}
const char* physkin_instruction_set(const physkin_garment* garment) { return garment->evaluator.instruction_set(); }

}  // extern "C"
