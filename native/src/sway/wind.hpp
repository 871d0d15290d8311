// Wind, as what it adds to the gravity that cloth is under.
//
// Air drags at cloth by its mass times kAirDrag times how fast the air passes it, whichever way cloth faces. So wind that
// is the same everywhere is a field as uniform as gravity: kAirDrag times its velocity is added to gravity's
// acceleration, and whatever drapes under effective gravity, or sways under one that changes, takes wind with it.
#pragma once

namespace physkin {

constexpr double kAirDrag = 2.0;        // [1/s] deceleration of cloth over its speed through still air, as simulated
constexpr double kLargestWind = 13;     // [m/s] with gravity across it, cloth then feels 2.8 times gravity
constexpr double kLargestFelt = 2.999;  // in units of gravity: wind never asks for what would be refused
constexpr double kFastestGust = 30;     // [m/s2] wind that is set anew rises, falls and turns no faster

class Wind {
 public:
  // Velocity [m/s] (3) in the world, Z up. What is wrong with it, or null; nothing has changed then.
  const char* set(const double* velocity) noexcept;
  const double* velocity() const noexcept { return velocity_; }

  // The root has this turn (unit quaternion x, y, z, w, world <- root).
  void face(const double* turn) noexcept;
  // Of the root only gravity's unit direction (3) in its frame is known. World is then the level frame that it has been
  // tilted out of on the shortest way: its X is where the root faces.
  void face_level(const double* direction) noexcept;
  // Gravity as it is given has all in it that pulls at cloth, and no wind is added.
  void leave_out() noexcept { left_out_ = true; }

  // Another frame, `seconds` after the last one, 0 where it comes again; negative: the wind blows as it was set.
  void blow(double seconds) noexcept;
  // To effective gravity (3) in units of gravity, root frame: adds what the wind of this frame does. It stays within what
  // networks know.
  void add_to(float* gravity) const noexcept;

 private:
  double velocity_[3] = {}, blowing_[3] = {};  // as set, and in the last frame
  double turn_[4] = {0, 0, 0, 1};
  double pull_[3] = {};  // in units of gravity, root frame
  bool left_out_ = false;
};

}  // namespace physkin
