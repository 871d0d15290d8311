#include "separation/limb_separator.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace physkin {
namespace {

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string("collision shape: ") + what);
}

// Every value from `low` to below `high`.
void check_range(const char* name, const std::vector<std::int32_t>& values, int low, std::size_t high) {
  for (std::int32_t value : values) {
    if (value < low || std::int64_t(value) >= std::int64_t(high)) {
      throw std::invalid_argument(std::string("collision shape: ") + name + " has " + std::to_string(value) +
                                  "; allowed: " + std::to_string(low) + " to " +
                                  std::to_string(std::int64_t(high) - 1));
    }
  }
}

}  // namespace

LimbSeparator::LimbSeparator(CollisionShape shape, const SeparationSettings& settings, const Kernels& kernels)
    : shape_(std::move(shape)), settings_(settings), kernels_(kernels) {
  check();
  limbs_ = int(shape_.limb_kind.size());
  spheres_ = int(shape_.sphere_bone.size());
  per_softness_ = 1.0f / settings_.softness;
  plan();
}

void LimbSeparator::check() const {
  const CollisionShape& s = shape_;
  const std::size_t bones = s.parents.size(), dofs = s.dof_bone.size(), spheres = s.sphere_bone.size();
  const std::size_t groups = s.group_reach.size(), limbs = s.limb_kind.size(), capsules = s.capsules.size() / 2;
  require(bones > 0 && s.heads.size() == 3 * bones, "heads must be three numbers a bone");
  require(s.dof_axis.size() == 3 * dofs && s.dof_rest.size() == dofs && s.dof_lower.size() == dofs &&
              s.dof_upper.size() == dofs,
          "arrays of degrees of freedom differ in length");
  require(!s.trunk_bones.empty() && s.trunk_heights.size() == s.trunk_bones.size(), "trunk_heights: one a trunk bone");
  require(s.trunk_frame.size() == 4 && s.trunk_frame[3] > s.trunk_frame[2], "trunk_frame: x, y, low, high");
  require(s.trunk_coefficients.size() >= 3 * kTrunkWaves && s.trunk_coefficients.size() % kTrunkWaves == 0,
          "trunk_coefficients must be rows of 9, at least three");
  require(s.sphere_centre.size() == 3 * spheres && s.sphere_radius.size() == spheres &&
              s.sphere_limb.size() == spheres && s.sphere_joints.size() == spheres,
          "arrays of spheres differ in length");
  require(s.capsules.size() == 2 * capsules && s.groups.size() == 2 * groups && s.pairs.size() % 3 == 0,
          "capsules and groups must be rows of 2, pairs of 3");
  require(s.limb_start.size() == limbs + 1 && s.limb_start.front() == 0 &&
              std::size_t(s.limb_start.back()) == s.limb_dofs.size(),
          "limb_start must lead into limb_dofs");
  for (std::size_t limb = 0; limb < limbs; ++limb) {
    const int joints = s.limb_start[limb + 1] - s.limb_start[limb];
    require(joints >= 0 && joints <= kMostJoints, "a limb has at most 8 joints");
  }
  require(settings_.softness > 0.0f && settings_.pull > 0.0f && settings_.blend > 0.0f && settings_.steps > 0,
          "softness, pull, blend and steps must be above zero");
  for (std::size_t bone = 0; bone < bones; ++bone) {
    require(s.parents[bone] >= -1 && s.parents[bone] < int(bone), "a parent must come before its child");
  }
  check_range("dof_bone", s.dof_bone, 0, bones);
  check_range("trunk_bones", s.trunk_bones, 0, bones);
  check_range("sphere_bone", s.sphere_bone, 0, bones);
  check_range("sphere_limb", s.sphere_limb, -1, limbs);
  check_range("sphere_joints", s.sphere_joints, 0, kMostJoints + 1);
  check_range("capsules", s.capsules, 0, spheres);
  check_range("groups", s.groups, 0, spheres + 1);
  check_range("limb_dofs", s.limb_dofs, 0, dofs);
  for (std::size_t sphere = 0; sphere < spheres; ++sphere) {
    const int limb = s.sphere_limb[sphere];
    require(s.sphere_joints[sphere] <= (limb < 0 ? 0 : s.limb_start[limb + 1] - s.limb_start[limb]),
            "sphere_joints: no more than its limb has");
  }
  for (std::size_t group = 0; group < groups; ++group) {
    const int first = s.groups[2 * group], last = s.groups[2 * group + 1];
    require(first < last && s.sphere_limb[first] >= 0, "a group must have spheres, of a limb");
  }
  for (std::size_t pair = 0; pair < s.pairs.size(); pair += 3) {
    const int group = s.pairs[pair], target = s.pairs[pair + 1], contact = s.pairs[pair + 2];
    require(group >= 0 && group < int(groups) && target >= -1 && target < int(capsules), "a pair names none there is");
    const int count = s.groups[2 * group + 1] - s.groups[2 * group];
    require(contact >= 0 && std::size_t(contact) + std::size_t(count) <= s.allowed.size(), "allowed: one a contact");
  }
  for (const auto* values :
       {&s.heads, &s.dof_axis, &s.dof_rest, &s.dof_lower, &s.dof_upper, &s.trunk_heights, &s.trunk_frame,
        &s.trunk_coefficients, &s.sphere_centre, &s.sphere_radius, &s.group_reach, &s.allowed}) {
    check_finite("collision shape", values->data(), values->size());
  }
}

// What a frame poses once, what each of its steps poses again, and room for all of it.
void LimbSeparator::plan() {
  const CollisionShape& s = shape_;
  const int bones = int(s.parents.size());
  std::vector<char> needed(bones);
  std::vector<int> mover(bones, -1);
  turns_anew_.resize(bones);
  for (std::int32_t bone : s.sphere_bone) needed[bone] = 1;
  for (std::int32_t bone : s.trunk_bones) needed[bone] = 1;
  limb_of_dof_.assign(dofs(), -1);
  place_of_dof_.assign(dofs(), -1);
  for (int limb = 0; limb < limbs_; ++limb) {
    for (int k = s.limb_start[limb]; k < s.limb_start[limb + 1]; ++k) {
      const int dof = s.limb_dofs[k], bone = s.dof_bone[dof];
      limb_of_dof_[dof] = limb;
      place_of_dof_[dof] = k - s.limb_start[limb];
      mover[bone] = limb;
      needed[bone] = turns_anew_[bone] = 1;
    }
  }
  for (int bone = bones; bone-- > 0;) {
    if (needed[bone] && s.parents[bone] >= 0) needed[s.parents[bone]] = 1;
  }
  limb_bones_.resize(limbs_);
  for (int bone = 0; bone < bones; ++bone) {
    const int parent = s.parents[bone];
    if (parent >= 0 && mover[parent] >= 0) {
      require(mover[bone] < 0 || mover[bone] == mover[parent], "a limb hangs from another limb");
      mover[bone] = mover[parent];
    }
    const Vector3 head = load_vector(&s.heads[3 * bone]);
    steps_.push_back(parent < 0 ? head : head - load_vector(&s.heads[3 * parent]));
    if (needed[bone]) (mover[bone] < 0 ? fixed_bones_ : limb_bones_[mover[bone]]).push_back(bone);
    dof_start_.push_back(int(dof_order_.size()));
    for (int k = 0; k < dofs(); ++k) {
      if (s.dof_bone[k] == bone) dof_order_.push_back(k);
    }
  }
  dof_start_.push_back(int(dof_order_.size()));
  for (std::int32_t bone : s.trunk_bones) require(mover[bone] < 0, "a trunk bone is below a joint of a limb");
  limb_spheres_.resize(limbs_ + 1);
  for (int k = 0; k < spheres_; ++k) {
    const int bone = s.sphere_bone[k], limb = s.sphere_limb[k];
    require(mover[bone] == limb, "a sphere of a limb must be on a bone that the limb's joints move");
    offsets_.push_back(load_vector(&s.sphere_centre[3 * k]) - load_vector(&s.heads[3 * bone]));
    limb_spheres_[limb < 0 ? limbs_ : limb].push_back(k);
  }
  for (std::size_t pair = 0; pair < s.pairs.size(); pair += 3) {
    const int group = s.pairs[pair], target = s.pairs[pair + 1];
    const int first = s.groups[2 * group], last = s.groups[2 * group + 1], limb = s.sphere_limb[first];
    int other = target < 0 ? -1 : s.sphere_limb[s.capsules[2 * target]];
    if (other >= 0 && s.limb_kind[other] != s.limb_kind[limb]) other = -1;  // legs do not give way to arms
    pairs_.push_back({first, last, limb, target, other, int(trunk_spheres_.size()),
                      s.group_reach[group] + settings_.onset, &s.allowed[s.pairs[pair + 2]]});
    for (int k = first; target < 0 && k < last; ++k) trunk_spheres_.push_back(k);
  }
  trunk_points_ = (int(trunk_spheres_.size()) + kTrunkPoints - 1) / kTrunkPoints * kTrunkPoints;
  back_ = arena_.take<float>(12 * s.trunk_bones.size());
  points_ = arena_.take<float>(3 * trunk_points_);
  contacts_ = arena_.take<float>(4 * trunk_points_);
  const float* frame = s.trunk_frame.data();
  trunk_ = {int(s.trunk_bones.size()),
            int(s.trunk_coefficients.size()) / kTrunkWaves,
            frame[0],
            frame[1],
            frame[2],
            frame[3],
            settings_.blend,
            back_,
            s.trunk_heights.data(),
            s.trunk_coefficients.data()};
  positions_.resize(dofs());
  turns_.resize(bones);
  posed_.resize(bones);
  centres_.resize(spheres_);
  capsules_.resize(s.capsules.size() / 2);
  joints_.resize(limbs_);
  normals_.resize(limbs_);
}

Rejection LimbSeparator::separate(const float* joint_positions, float* separated, float* largest_change) noexcept {
  if (const auto bad = reject_beyond("joint_positions", joint_positions, dofs(), kLargest)) return bad;
  std::copy_n(joint_positions, dofs(), positions_.data());
  for (int bone : fixed_bones_) pose_bone(bone);
  for (int limb = 0; limb < limbs_; ++limb) {
    for (int bone : limb_bones_[limb]) pose_bone(bone);
    place_spheres(limb);
  }
  place_spheres(limbs_);
  for (int k = 0; k < trunk_.bones; ++k) {
    const int bone = shape_.trunk_bones[k];
    const Matrix3& turn = posed_[bone].linear;
    const Matrix3 back = from_columns(turn.rows[0], turn.rows[1], turn.rows[2]);
    store_affine({back, load_vector(&shape_.heads[3 * bone]) - back * posed_[bone].translation}, back_ + 12 * k);
  }
  for (Normal& normal : normals_) normal.moved = false;
  for (int at = 0; at < settings_.steps; ++at) {
    for (int limb = 0; at > 0 && limb < limbs_; ++limb) {
      if (normals_[limb].moved) pose_limb(limb);
    }
    place_capsules();
    for (std::size_t k = 0; k < trunk_spheres_.size(); ++k) {
      const Vector3 centre = centres_[trunk_spheres_[k]];
      points_[k] = centre.x;
      points_[trunk_points_ + int(k)] = centre.y;
      points_[2 * trunk_points_ + int(k)] = centre.z;
    }
    kernels_.trunk_depth(trunk_, points_, trunk_points_, contacts_);
    for (Normal& normal : normals_) normal = {{}, {}, false, normal.moved};
    for (const Pair& pair : pairs_) meet(pair);
    bool stepped = false;
    for (int limb = 0; limb < limbs_; ++limb) stepped |= step(limb, joint_positions);
    if (!stepped) break;  // no further step would find anything else
  }
  float largest = 0.0f;
  for (int k = 0; k < dofs(); ++k) largest = std::max(largest, std::fabs(positions_[k] - joint_positions[k]));
  *largest_change = largest;
  std::copy(positions_.begin(), positions_.end(), separated);
  return {};
}

void LimbSeparator::pose_bone(int bone) {
  const int parent = shape_.parents[bone];
  Affine& posed = posed_[bone];
  const Matrix3& above = parent < 0 ? kIdentity3 : posed_[parent].linear;
  posed.translation = parent < 0 ? steps_[bone] : posed_[parent].translation + above * steps_[bone];
  if (!turns_anew_[bone]) {
    turns_[bone] = kIdentity3;
    for (int at = dof_start_[bone]; at < dof_start_[bone + 1]; ++at) {
      const int k = dof_order_[at];
      turns_[bone] = turns_[bone] * rotation(load_vector(&shape_.dof_axis[3 * k]), positions_[k] - shape_.dof_rest[k]);
    }
    posed.linear = above * turns_[bone];
    return;
  }
  posed.linear = above;
  for (int at = dof_start_[bone]; at < dof_start_[bone + 1]; ++at) {
    const int k = dof_order_[at];
    const Vector3 axis = load_vector(&shape_.dof_axis[3 * k]);
    if (const int place = place_of_dof_[k]; place >= 0) {
      const Vector3 now = posed.linear * axis, moment = cross(now, posed.translation);
      Joints& joints = joints_[limb_of_dof_[k]];
      for (int i = 0; i < 3; ++i) {
        joints.axis[i][place] = i == 0 ? now.x : i == 1 ? now.y : now.z;
        joints.moment[i][place] = i == 0 ? moment.x : i == 1 ? moment.y : moment.z;
      }
    }
    posed.linear = posed.linear * rotation(axis, positions_[k] - shape_.dof_rest[k]);
  }
}

// As the last step left it; what no step changes keeps its turn.
void LimbSeparator::pose_limb(int limb) {
  for (int bone : limb_bones_[limb]) {
    if (turns_anew_[bone]) {
      pose_bone(bone);
      continue;
    }
    const Affine& above = posed_[shape_.parents[bone]];
    posed_[bone] = {above.linear * turns_[bone], above.translation + above.linear * steps_[bone]};
  }
  place_spheres(limb);
}

// Of a limb; of `limbs_`, those that no limb moves.
void LimbSeparator::place_spheres(int limb) {
  for (int k : limb_spheres_[limb]) {
    const Affine& bone = posed_[shape_.sphere_bone[k]];
    centres_[k] = bone.linear * offsets_[k] + bone.translation;
  }
}

void LimbSeparator::meet(const Pair& pair) {
  if (pair.target < 0) {
    for (int k = pair.first, at = pair.trunk_point; k < pair.last; ++k, ++at) {
      const float excess = contacts_[at] + shape_.sphere_radius[k] + settings_.onset - pair.allowed[k - pair.first];
      if (excess <= 0.0f) continue;
      const float* normal = contacts_ + trunk_points_ + at;
      give_way(pair, k, {contacts_[at], {normal[0], normal[trunk_points_], normal[2 * trunk_points_]}, 0.0f}, excess);
    }
    return;
  }
  const Capsule capsule = capsules_[pair.target];
  const float widest = std::max(capsule.narrow, capsule.wide);
  const auto along_at = [&](Vector3 from) {
    return std::min(std::max(dot(from, capsule.way) * capsule.inverse, 0.0f), 1.0f);
  };
  // Whether any of the group can reach the capsule: a bound, so that it changes nothing.
  const Vector3 middle = centres_[(pair.first + pair.last) / 2] - capsule.start;
  const Vector3 apart = middle - along_at(middle) * capsule.way;
  const float reach = pair.reach + widest;
  if (dot(apart, apart) > reach * reach) return;
  for (int k = pair.first; k < pair.last; ++k) {
    const Vector3 from = centres_[k] - capsule.start;
    const float along = along_at(from), room = shape_.sphere_radius[k] + settings_.onset - pair.allowed[k - pair.first];
    const Vector3 offset = from - along * capsule.way;
    const float squared = dot(offset, offset) + float(kCapsuleBlur) * float(kCapsuleBlur), most = widest + room;
    if (most <= 0.0f || squared >= most * most) continue;
    const float distance = std::sqrt(squared);
    const float depth = capsule.narrow + smooth_step(along) * (capsule.wide - capsule.narrow) - distance;
    if (depth + room > 0.0f) give_way(pair, k, {depth, (1.0f / distance) * offset, along}, depth + room);
  }
}

void LimbSeparator::place_capsules() {
  for (std::size_t k = 0; k < capsules_.size(); ++k) {
    const int start = shape_.capsules[2 * k], end = shape_.capsules[2 * k + 1];
    const Vector3 way = centres_[end] - centres_[start];
    capsules_[k] = {centres_[start], way, 1.0f / std::max(dot(way, way), 1e-9f), shape_.sphere_radius[start],
                    shape_.sphere_radius[end]};
  }
}

// Counts a contact of a sphere into the quadratic of its limb, and of the other limb where that gives way, too.
void LimbSeparator::give_way(const Pair& pair, int sphere, const Contact& contact, float excess) {
  const float bent = std::min(excess, settings_.softness), weight = bent * per_softness_;
  const float value = 0.5f * bent * weight + std::max(excess - settings_.softness, 0.0f);
  const float counted = pair.other >= 0 ? 2.0f : 1.0f;
  float way[kMostJoints] = {};
  count(sphere, pair.limb, centres_[sphere], contact.normal, 1.0f, way);
  add(pair.limb, way, value, weight, counted, -1.0f);
  if (pair.other < 0) return;
  const int start = shape_.capsules[2 * pair.target], end = shape_.capsules[2 * pair.target + 1];
  const Vector3 point = centres_[start] + contact.along * (centres_[end] - centres_[start]);
  std::fill_n(way, kMostJoints, 0.0f);
  count(start, pair.other, point, contact.normal, 1.0f - contact.along, way);
  count(end, pair.other, point, contact.normal, contact.along, way);
  add(pair.other, way, value, weight, counted, 1.0f);
}

// Adds how far a point that a sphere's bone carries goes in a direction by each joint of its limb [m/rad], times share:
// axis . ((point - pivot) x direction), rearranged so that all joints are computed at once.
void LimbSeparator::count(int sphere, int limb, Vector3 point, Vector3 direction, float share, float* way) const {
  const Joints& joints = joints_[limb];
  const Vector3 turn = share * cross(point, direction), along = share * direction;
  const int moving = shape_.sphere_joints[sphere];  // the limb's first joints: others are below the sphere
  for (int k = 0; k < kMostJoints; ++k) {
    way[k] += (k < moving ? 1.0f : 0.0f) *
              (joints.axis[0][k] * turn.x + joints.axis[1][k] * turn.y + joints.axis[2][k] * turn.z -
               joints.moment[0][k] * along.x - joints.moment[1][k] * along.y - joints.moment[2][k] * along.z);
  }
}

void LimbSeparator::add(int limb, const float* way, float value, float weight, float counted, float sign) {
  Normal& normal = normals_[limb];
  const int joints = shape_.limb_start[limb + 1] - shape_.limb_start[limb];
  const float slope = sign * value * weight, curvature = counted * weight * weight;
  for (int k = 0; k < kMostJoints; ++k) normal.slope[k] += slope * way[k];
  for (int i = 0; i < joints; ++i) {
    const float factor = curvature * way[i];
    for (int k = 0; k < kMostJoints; ++k) normal.curvature[i][k] += factor * way[k];
  }
  normal.met = true;
}

// Whether the limb may have moved. Cholesky's factorisation in place.
bool LimbSeparator::step(int limb, const float* given) {
  Normal& normal = normals_[limb];
  if (!normal.met && !normal.moved) return false;
  normal.moved = true;
  const int first = shape_.limb_start[limb], joints = shape_.limb_start[limb + 1] - first;
  float (&a)[kMostJoints][kMostJoints] = normal.curvature;
  float x[kMostJoints];
  for (int i = 0; i < joints; ++i) {
    const int k = shape_.limb_dofs[first + i];
    a[i][i] += settings_.pull + settings_.damping;
    x[i] = -normal.slope[i] - settings_.pull * (positions_[k] - given[k]);
    for (int j = 0; j < i; ++j) {
      for (int l = 0; l < j; ++l) a[i][j] -= a[i][l] * a[j][l];
      a[i][j] /= a[j][j];
      a[i][i] -= a[i][j] * a[i][j];
      x[i] -= a[i][j] * x[j];
    }
    a[i][i] = std::sqrt(std::max(a[i][i], 0.1f * settings_.pull));  // in single precision
    x[i] /= a[i][i];
  }
  for (int i = joints; i-- > 0;) {
    for (int j = i + 1; j < joints; ++j) x[i] -= a[j][i] * x[j];
    x[i] /= a[i][i];
    const int k = shape_.limb_dofs[first + i];
    const float low = std::min(shape_.dof_lower[k], given[k]), high = std::max(shape_.dof_upper[k], given[k]);
    positions_[k] = std::clamp(positions_[k] + x[i], low, high);
  }
  return true;
}

}  // namespace physkin
