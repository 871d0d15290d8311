// What the garments of one avatar are given in a frame besides joint positions: how gravity pulls at each, how the root
// moves, and how much time has passed. The one place where that is worked out: Python, the ROS node, replay and C hosts
// fill the rows that Evaluator::step reads by it.
//
// In each frame first where down is, by one of `hang`, `accelerate`, `follow` and `move`; then the time, by
// `begin_frame` or `begin_still_frame`, which add the wind. Functions that can refuse their values return what is wrong
// with them, or null; nothing has changed then.
#pragma once

#include <vector>

#include "evaluator/garment_input.hpp"
#include "sway/root_tracker.hpp"
#include "sway/wind.hpp"

namespace physkin {

// In units of gravity; training knows no more.
constexpr double kLargestEffectiveGravity = 3;
// [m/s, rad/s] A root is taken to be no faster; all beyond some metres a second is alike to cloth.
constexpr double kFastest = 1e6;

class FrameInput {
 public:
  explicit FrameInput(int garments) : sways_(std::size_t(garments), 1), rows_(std::size_t(garments)) {}

  // How much its cloth swings: 0, it hangs as if nothing had moved, to 1, all of it.
  void set_sway(int garment, double amount) noexcept { sways_[std::size_t(garment)] = amount; }
  double sway(int garment) const noexcept { return sways_[std::size_t(garment)]; }

  // Wind that blows from now on, whatever sways: velocity [m/s] (3) in the world of the root, at most kLargestWind long.
  const char* set_wind(const double* velocity) noexcept { return wind_.set(velocity); }
  const double* wind() const noexcept { return wind_.velocity(); }

  // Cloth hangs still in the next frame, as in a first one, and nothing is known of the root.
  void reset() noexcept;

  // The root is at rest: gravity's unit direction (3) in its frame. Wind is in the level frame that faces as it does.
  const char* hang(const double* direction) noexcept;
  // The root is accelerated, and it is not known how it moves: gravity less its acceleration (3) [m/s2], in its frame.
  // Each garment feels as much of what that differs from `at_rest` (3) as it sways, and wind as of `hang`. Null: all of
  // it, and wind is taken to be in it.
  const char* accelerate(const double* effective_gravity, const double* at_rest) noexcept;
  // The root moves as a tracker knows it.
  void follow(const RootSample& root) noexcept;
  // The same by a tracker of its own; as RootTracker::move.
  const char* move(double time, const double* root) noexcept;

  // A frame at `time` [s], of any clock, at any rate. After more than a quarter of a second, or where the clock goes
  // back, the frame before does not count. Where it stands, as a joint state may come in parts, the time passed stays
  // that of the frame before.
  const char* begin_frame(double time) noexcept;
  // A frame that stands by itself, and ends what was before.
  void begin_still_frame() noexcept;

  int count() const noexcept { return int(rows_.size()); }
  // (count) as of the last frame begun; may be changed in place.
  GarmentInput* rows() noexcept { return rows_.data(); }

 private:
  void blow(double seconds) noexcept;

  std::vector<double> sways_;
  std::vector<GarmentInput> rows_;
  RootTracker root_;
  Wind wind_;
  bool rates_known_ = true;
  bool has_time_ = false;
  double time_ = 0;
  float passed_ = -1;
};

}  // namespace physkin
